"""What a function would ignore or take for something else is refused, with the right spelling."""

from __future__ import annotations

import inspect
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from checks import refusal
from commands import oracle

import posefuse as pf
from posefuse.api import calibrate, compare, recording, track
from posefuse.api.arguments import checked
from posefuse.core import ConfigError, InputError

KINDS = ("bool", "Sequence[str]", "Mapping[str, Any]")


def public_functions() -> list[Callable[..., Any]]:
    found = [getattr(pf.Recording, name) for name in vars(recording.Recording) if not name.startswith("_")]
    for module in (calibrate, compare, recording, track):
        found += [one for name, one in vars(module).items() if inspect.isfunction(one) and one.__module__ == module.__name__]
    return [one for one in found if inspect.isfunction(one) and not one.__name__.startswith("_")]


def test_every_function_with_a_flag_checks_its_arguments() -> None:
    with_flags = {
        one.__name__: one
        for one in public_functions()
        if any(str(given.annotation).removesuffix(" | None") in KINDS for given in inspect.signature(one).parameters.values())
    }
    assert {"track", "solve", "save", "export", "report", "compare", "calibrate_extrinsics"} <= set(with_flags)
    assert not [name for name, one in with_flags.items() if not hasattr(one, "__wrapped__")]


@checked
def example(
    path: str,
    *,
    flag: bool = True,
    count: int | None = None,
    names: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
) -> str:
    """Any function."""
    return path


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"flag": {"cutoff_hz": 2}}, r"flag: expected True or False, .*; its settings are .* settings=\{'flag.KEY': VALUE\}"),
        ({"flag": 1}, "example: flag: expected True or False, got 1$"),
        ({"count": 2.5}, "example: count: expected a whole number, got 2.5"),
        ({"count": True}, "count: expected a whole number, got True"),
        ({"names": "trc"}, "names: expected a list of names, got 'trc'"),
        ({"names": [3]}, "names: expected a list of names"),
        ({"settings": "smooth.raw=2"}, r"settings: expected settings by dotted key, \{'KEY': VALUE\}, got 'smooth.raw=2'"),
    ],
)  # fmt: skip
def test_a_value_of_another_kind_is_refused_by_name(given: dict[str, Any], message: str) -> None:
    refusal(InputError, message, example, "a", **given)


def test_what_fits_passes_and_other_errors_are_those_of_python() -> None:
    assert example("a", flag=False, count=3, names=("trc",), settings={"a": 1}) == "a"
    assert example("a", count=None, settings=None) == "a"
    refusal(TypeError, "unexpected keyword argument 'flags'", example, "a", flags=True)


def test_a_result_is_not_taken_for_a_session(make_recording: Callable[..., pf.Recording], tmp_path: Path) -> None:
    """Its overlay.mp4 was taken for a camera."""
    make_recording().save(tmp_path / "result")
    refusal(InputError, r"holds a result, not a session; .*pf\.read\(RESULT\)\.solve\(\)", pf.track, tmp_path / "result")


def test_a_rig_that_is_no_path_is_refused(demo_session: Path) -> None:
    refusal(ConfigError, "rig: .*got 5", pf.track, demo_session, settings={"rig": 5})


@pytest.mark.parametrize(("formats", "written"), [(None, {"pose.trc"}), (("csv",), {"pose.csv"}), ((), set())])
def test_the_outputs_of_the_settings_file_are_written_unless_others_are_named(
    demo_session: Path, tmp_path: Path, formats: tuple[str, ...] | None, written: set[str]
) -> None:
    own = Path(shutil.copytree(demo_session, tmp_path / "session"))
    (own / "posefuse.toml").write_text('outputs = ["trc"]\n')
    pf.track(own, out=tmp_path / "result", formats=formats, end_s=0.3, settings=oracle())
    assert {path.name for path in (tmp_path / "result").glob("pose.*") if path.suffix != ".json"} == written
