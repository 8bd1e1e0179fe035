"""Values and long calls are written by keyword: two arrays of one shape in the wrong order would pass every check."""

import ast
from dataclasses import MISSING, fields

import pytest
from checks import refusal

import posefuse.core as core
from packages import shown, source_files

MOST = 6
# compiled kernels take positions only (modules `*kernels`, and what is imported from them), and so do these libraries
POSITIONS_ONLY = ("robust", "linear", "cv2", "osim", "_mujoco")
FILES = [path for path in source_files() if "kernels" not in path.stem and "kernels" not in path.parts]
VALUES = (
    core.Camera, core.CameraTruth, core.Detections2D, core.Frame, core.JointAngles, core.Observations, core.Pose3D,
    core.PoseSequence, core.Recording, core.Region, core.Truth, core.ViewSequence, core.Views,
)  # fmt: skip


def too_long(text: str) -> list[str]:
    """Calls with more than `MOST` positional arguments, kernels and libraries that know no names excepted."""
    nodes = [*ast.walk(ast.parse(text))]
    homes = {name.name: str(node.module) for node in nodes if isinstance(node, ast.ImportFrom) for name in node.names}
    calls = (node for node in nodes if isinstance(node, ast.Call) and len(node.args) > MOST)
    names = [(node.lineno, ast.unparse(node.func)) for node in calls]
    parts = {name: {*homes.get(name, "").split("."), *name.split(".")[:-1]} for _, name in names}
    exempt = {name for name, some in parts.items() if some & set(POSITIONS_ONLY) or any(one.endswith("kernels") for one in some)}
    return [f"line {line}: {name}" for line, name in names if name not in exempt]


def test_no_call_has_more_than_six_positions() -> None:
    found = {shown(path): too_long(path.read_text(encoding="utf-8")) for path in FILES}
    assert FILES and {path: calls for path, calls in found.items() if calls} == {}


def test_the_guard_of_positions_can_fail() -> None:
    assert too_long("f(1, 2, 3, 4, 5, 6, 7)") == ["line 1: f"]
    assert not too_long("f(1, 2, 3, 4, 5, 6, g=7)\nkernels.step(1, 2, 3, 4, 5, 6, 7)\n")
    assert not too_long("from .kernels.step import step\nstep(1, 2, 3, 4, 5, 6, 7)\n")
    assert too_long("from .others import step\nstep(1, 2, 3, 4, 5, 6, 7)\n")


@pytest.mark.parametrize("value", VALUES, ids=lambda v: v.__name__)
def test_core_values_are_built_by_keyword_only(value: type) -> None:
    wanted = [one for one in fields(value) if one.init]
    assert wanted and all(one.kw_only for one in wanted), [one.name for one in wanted if not one.kw_only]
    required = [one for one in wanted if one.default is MISSING and one.default_factory is MISSING]
    refusal(TypeError, "positional", value, *(None for _ in required))
