"""`import posefuse` shows what it offers, stays light, and everything it names exists and is documented."""

import inspect
import subprocess
import sys

import pytest

import posefuse as pf


def test_what_tab_completion_shows_is_what_is_exported() -> None:
    assert dir(pf) == sorted(pf.__all__)


@pytest.mark.parametrize("name", [name for name in pf.__all__ if name != "__version__"])
def test_every_public_name_exists_and_has_a_docstring(name: str) -> None:
    value = getattr(pf, name)
    assert inspect.getdoc(value)


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'trakc'"):
        _ = pf.trakc


def test_functions_are_found_whatever_was_imported_before() -> None:
    code = "import posefuse.tracking, posefuse.simulation, posefuse.evaluation.compare, posefuse as pf; print(callable(pf.track))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert run.stdout.strip() == "True"


def test_the_package_is_typed_for_its_users() -> None:
    from importlib.resources import files

    assert files("posefuse").joinpath("py.typed").is_file()


@pytest.mark.parametrize("name", ["compare", "detector", "live", "recording", "rig", "simulate", "track"])
def test_examples_in_docstrings_run(name: str) -> None:
    import doctest
    from importlib import import_module

    assert doctest.testmod(import_module(f"posefuse.api.{name}")).failed == 0
