"""The checks of a solved rig and of its size, the quick ones first."""

from __future__ import annotations

import numpy as np

from posefuse.calibration.report import CalibrationReport, Check
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Charuco, Target, scale_m
from posefuse.core import SE3, Camera
from posefuse.core.arrays import Array

from . import self_checks as checks
from .halves import Halves, half_checks, solve_halves
from .lens_check import LensChange, check_board_shape, check_lenses, lens_change
from .limits import Limits
from .own_intrinsics import check_carried
from .pipeline import Options, Solved, thinned
from .prop_solve import Freedom, PropSolution, solve_prop
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


_FREE_FOCAL, _FREE_LENS = 0.2, (10.0, 10.0, 0.05, 0.05)


def solution_checks(
    observations: CornerObservations,
    cameras: tuple[Camera, ...],
    target: Target,
    options: Options,
    solved: Solved,
    before: list[Check],
) -> list[Check]:
    """All checks of a solution; raises RefusedCalibration after the quick ones, since the others take further solves."""
    state, limits, distance_m = solved.solution.state, options.limits, usual_distance_m(solved)
    quick = [
        checks.check_still(cameras, solved, limits),
        checks.check_facing(cameras, solved, limits),
        checks.check_fit(cameras, solved, limits),
        checks.check_cameras_agree(cameras, solved, limits),
        checks.check_determined(cameras, solved, distance_m, limits),
        checks.check_cameras_apart(cameras, state.cam_from_world, limits),
        check_rig_size(target, cameras, state.cam_from_world.se3(), distance_m, limits),
    ]
    if options.own_intrinsics:
        quick.insert(0, check_carried(cameras, observations, solved, limits))
    CalibrationReport("extrinsics", (*before, *quick)).require()
    halves = solve_halves(observations, cameras, target, options, solved)
    done = [
        *quick,
        *half_checks(cameras, solved, halves, distance_m, limits),
        check_lenses(cameras, _lens_change(cameras, solved, halves, options), limits),
    ]
    if isinstance(target, Charuco):
        done.append(check_board_shape(thinned(solved), cameras, limits))
    if options.clocks == "together":
        freedom = Freedom(reference=solved.links.reference, held_patches=solved.links.shape.held, offset=True)
        free = solve_prop(solved.seen, solved.corners, cameras, state, freedom)
        done.append(checks.check_clocks(cameras, free.state.delay_s[:, 0], free.delay_sigma_s[:, 0], limits))
    return done


def _lens_change(cameras: tuple[Camera, ...], solved: Solved, halves: Halves, options: Options) -> LensChange:
    parts = [_change_of(cameras, half, False) for half in halves.solved]
    return _change_of(cameras, solved, options.clocks != "together").confirmed_by(parts)


def _change_of(cameras: tuple[Camera, ...], solved: Solved, offset: bool) -> LensChange:
    free = let_lenses_free(cameras, solved, offset)
    return lens_change(cameras, solved.solution, free, solved.seen, usual_distance_m(solved))


def let_lenses_free(cameras: tuple[Camera, ...], solved: Solved, offset: bool, of: tuple[int, ...] | None = None) -> PropSolution:
    """The solve again with nearly free intrinsics, of all cameras or of some."""
    focal_px = _FREE_FOCAL * float(focal_lengths_px(cameras).mean())
    sigma = np.array([focal_px, focal_px, *_FREE_LENS])
    freedom = Freedom(
        reference=solved.links.reference,
        held_patches=solved.links.shape.held,
        offset=offset,
        drift=False,
        lens_sigma=sigma,
        lens_of=of,
    )
    return solve_prop(solved.seen, solved.corners, cameras, solved.solution.state, freedom)


def focal_lengths_px(cameras: tuple[Camera, ...]) -> Array:
    """(C,) fx."""
    return np.array([camera.K[0, 0] for camera in cameras])


def usual_distance_m(solved: Solved) -> float:
    """Median distance of the target from the cameras."""
    seen, state = solved.seen, solved.solution.state
    in_cam = state.cam_from_world[seen.camera].move(state.world_from_prop.t[seen.time_step])
    return float(np.median(np.linalg.norm(in_cam, axis=1)))
