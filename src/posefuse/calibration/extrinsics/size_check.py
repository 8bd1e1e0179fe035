"""Whether target and rig have the size of things and rooms: units mixed up show nowhere else."""

from __future__ import annotations

from posefuse.calibration.report import Check
from posefuse.calibration.targets.kinds import Charuco, Target, scale_m
from posefuse.core import SE3, Camera

from .limits import Limits
from .self_checks import nearest_two

_MM = 1000.0
UNITS = "sizes are millimetres on the command line, metres in Python"


def _edge(target: Target) -> str:
    return "square" if isinstance(target, Charuco) else "marker side"


def check_target_size(target: Target, limits: Limits) -> Check:
    """A marker or square can be printed and carried."""
    side_m, (least_m, most_m) = scale_m(target), limits.target_side_m
    return Check(
        "target has a plausible size", least_m <= side_m <= most_m,
        f"{_edge(target)} {side_m * _MM:g} mm (expected {least_m * _MM:g} to {most_m * _MM:g} mm)",
        f"check the unit: {UNITS}", "input",
    )  # fmt: skip


def check_rig_size(target: Target, cameras: tuple[Camera, ...], cam_from_world: SE3, distance_m: float, limits: Limits) -> Check:
    """Target and cameras are as far from each other as in a room in which a person moves."""
    a, b, apart_m = nearest_two(cam_from_world.inverse().xyz)
    least_m, most_m = limits.distance_m
    return Check(
        "rig has a plausible size", least_m <= distance_m <= most_m,
        f"with a {_edge(target)} of {scale_m(target) * _MM:g} mm the target was {distance_m:.2f} m from the cameras, and"
        f" {cameras[a].name} and {cameras[b].name} are {apart_m:.2f} m apart"
        f" (expected a distance of {least_m:g} to {most_m:g} m)",
        f"measure the print: {UNITS}; for a rig that really has this size add `any_size=True`", "input",
    )  # fmt: skip
