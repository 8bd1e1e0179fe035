"""`import posefuse` shows what it offers, stays light, and everything it names exists and is documented."""

from __future__ import annotations

import ast
import inspect
import math
import shutil
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import pytest
from checks import refusal
from commands import oracle
from running import python

import posefuse as pf
from posefuse import core, fusion
from posefuse.api import calibrate, compare, recording, track
from posefuse.api.arguments import checked
from posefuse.core import SKELETONS, ConfigError, InputError


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
    code = "import posefuse.tracking, posefuse_sim, posefuse.evaluation.compare, posefuse as pf; print(callable(pf.track))"
    assert python("-c", code).stdout.strip() == "True"


def test_the_package_is_typed_for_its_users() -> None:
    from importlib.resources import files

    assert files("posefuse").joinpath("py.typed").is_file()


@pytest.mark.parametrize("package", [core, fusion])
def test_a_strict_type_checker_knows_the_bases_of_public_classes(package: ModuleType) -> None:
    """Without the list `pf.Recording` and `pf.Rig` were derived from Any: mypy accepted every attribute of theirs."""
    tree = ast.parse(inspect.getsource(package))
    [checking] = [node for node in tree.body if isinstance(node, ast.If)]
    assert set(package.__all__) == {alias.name for line in checking.body for alias in line.names}


@pytest.mark.parametrize("name", sorted(name for name in pf.__all__ if inspect.isfunction(getattr(pf, name))))
def test_every_public_function_has_an_example_that_runs(name: str) -> None:
    """Those that need recordings, cameras or a network are only parsed here; `tests/api/test_gallery.py` runs such programs."""
    import doctest

    [test] = [one for one in doctest.DocTestFinder(recurse=False).find(getattr(pf, name), globs={}) if one.examples]
    assert doctest.DocTestRunner().run(test).failed == 0


def test_values_print_in_one_short_line(ring_rig) -> None:
    rig = ring_rig(4)
    pose = pf.Pose3D.empty(5, SKELETONS["blazepose33"])
    observed = pf.Detections2D.empty("cam00", 7, pose.skeleton)
    assert repr(rig).startswith("Rig(4 cameras: cam00, cam01, cam02, cam03; id ")
    assert repr(rig.cameras[0]) == "Camera(cam00, 640x480 px, pinhole)"
    assert repr(pose) == "Pose3D(at 5 ns, people (ids) [], Skeleton(blazepose33, 33 keypoints, 29 bones))"
    assert repr(observed) == "Detections2D(0 people in cam00 at 7 ns, Skeleton(blazepose33, 33 keypoints, 29 bones))"
    assert repr(pf.PoseSequence.from_poses([pose])).startswith("PoseSequence(1 time steps, people (ids) [], Skeleton(")


def test_a_problem_is_shown_each_time_at_the_line_of_the_program(make_recording, ring_rig, tmp_path: Path) -> None:
    """Python shows the same words once: of the next recordings of a loop, and of a cell run again, they were not shown."""
    rig, recording = replace(ring_rig(2), refused="scale"), make_recording()
    recording.save(tmp_path / "result")
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("default")
        for _ in range(2):
            pf.live(rig, {"cam00": "usb:0", "cam01": "usb:1"})
            recording.save(tmp_path / "result", replace=True)
    assert ["refused (scale)" in str(one.message) for one in shown] == [True, False, True, False]
    assert {one.filename for one in shown} == {__file__}


# --- what a function would ignore or take for something else is refused, with the right spelling


KINDS = ("bool", "Sequence[str]", "Mapping[str, float]", "Mapping[str, Any]")


def public_functions() -> list[Callable[..., Any]]:
    found = [getattr(pf.Recording, name) for name in vars(recording.Recording) if not name.startswith("_")]
    for module in (calibrate, compare, recording, track):
        found += [one for name, one in vars(module).items() if inspect.isfunction(one) and one.__module__ == module.__name__]
    return [one for one in found if inspect.isfunction(one) and not one.__name__.startswith("_")]


def test_every_function_with_a_flag_checks_its_arguments() -> None:
    def kinds(function: Callable[..., Any]) -> set[str]:
        return {str(one.annotation).removesuffix(" | None") for one in inspect.signature(function).parameters.values()}

    with_flags = {one.__name__: one for one in public_functions() if kinds(one) & {*KINDS}}
    assert {"track", "solve", "save", "export", "compare", "calibrate_extrinsics"} <= set(with_flags)
    assert not [name for name, one in with_flags.items() if not hasattr(one, "__wrapped__")]


Colour = Literal["red", "green"]


@checked
def example(
    path: str,
    *,
    flag: bool = True,
    count: int | None = None,
    names: Sequence[str] = (),
    late_s: Mapping[str, float] | None = None,
    settings: Mapping[str, Any] | None = None,
    colour: Colour | None = None,
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
        ({"late_s": 0.1}, "late_s: expected finite numbers by name, got 0.1"),
        ({"late_s": {"cam00": math.nan}}, "late_s: expected finite numbers by name, got {'cam00': nan}"),
        ({"colour": "rde"}, "colour: expected one of red, green, got 'rde'"),
        ({"colour": 3}, "colour: expected one of red, green, got 3"),
        ({"settings": "smooth.raw=2"}, r"settings: expected settings by dotted key, \{'KEY': VALUE\}, got 'smooth.raw=2'"),
    ],
)  # fmt: skip
def test_a_value_of_another_kind_is_refused_by_name(given: dict[str, Any], message: str) -> None:
    refusal(InputError, message, example, "a", **given)


def test_arguments_by_place_are_checked_as_those_by_name(make_recording: Callable[..., pf.Recording], tmp_path: Path) -> None:
    refusal(InputError, "export: formats: expected a list of names, got 'trc'", make_recording().export, tmp_path, "trc")
    refusal(InputError, "models: names: expected a list of names, got 'blazepose_full'", pf.models, "blazepose_full", check=True)


def test_a_fit_that_does_not_exist_is_refused(make_recording: Callable[..., pf.Recording], tmp_path: Path) -> None:
    """It was taken for ``rays``."""
    refusal(InputError, "joint_angles: fit: expected one of points, none, got 'ray'", make_recording().joint_angles, fit="ray")
    refusal(InputError, "report: fit: expected one of", make_recording().report, tmp_path / "report", fit="ray")
    refusal(
        InputError, "calibrate_person: clocks: expected one of", pf.calibrate_person, {}, intrinsics="rig.toml", clocks="late"
    )


def test_what_fits_passes_and_other_errors_are_those_of_python() -> None:
    assert example("a", flag=False, count=3, names=("trc",), late_s={"cam00": 0.1}, settings={"a": 1}) == "a"
    assert example("a", count=None, settings=None, colour="red") == example("a", colour=None) == "a"
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


def test_names_without_a_person_are_said(demo_session: Path) -> None:
    said: list[str] = []
    settings = oracle() | {"names": ["Ada", "Ben", "Cleo"]}
    pf.track(demo_session, end_s=0.3, settings=settings, progress=lambda stage, done, of, line=None: said.append(line or ""))
    assert "1 person found: no one has the name Ben, Cleo" in said


def test_an_output_named_twice_is_written_once(make_recording: Callable[..., pf.Recording], tmp_path: Path) -> None:
    files = make_recording().export(tmp_path / "a", ["csv", "csv"]).files
    assert len(files) == len(set(files))
