"""Where the cameras are, from one walking person alone: 2D keypoints, intrinsics, and one known length for the scale.

A rough answer first (`person.start`), then one robust bundle adjustment over all cameras and keypoints. The same checks as
for a prop stand between this and a rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.extrinsics.self_checks import camera_differences
from posefuse.calibration.extrinsics.target import world_checks
from posefuse.calibration.extrinsics.world import FloorFromFeet, FloorUnderBody, triangulate_linear
from posefuse.calibration.report import CalibrationReport, Check
from posefuse.calibration.solving.rotations import Poses
from posefuse.core import SE3, Camera, Rig, Skeleton
from posefuse.core.arrays import Array

from .bundle import PersonSolution, freed, solve_person_bundle
from .checks import (
    check_intrinsics,
    check_person_in_views,
    check_same_video_by_person,
    check_synchronised,
    check_walk,
    inliers,
    likely_person_causes,
    person_solution_checks,
    spread_m,
)
from .scale import STATURE_SIGMA, KnownLength, stature_m
from .standing import STANDING_POINTS, check_standing
from .views import PersonViews

_SUBJECT = "extrinsics from a person"
# feet that spread less across their path than this do not determine the vertical
_PLANE_M = 0.15
_HALVES_SHARE, _HALVES_RAD = 0.03, np.deg2rad(1.5)
_SOLES = ("left_heel", "right_heel", "left_big_toe", "right_big_toe", "left_foot_index", "right_foot_index")
_ANKLES = ("left_ankle", "right_ankle")
# height of an ankle above the sole, as a share of the person's height (Drillis and Contini 1966)
_ANKLE_SHARE = 0.039
_HEADS = ("head", "nose", "neck")
_HIPS = ("left_hip", "right_hip")


@dataclass(frozen=True, eq=False)
class PersonCalibration:
    """A rig from a person, which passed its checks."""

    rig: Rig
    report: CalibrationReport


def rough_rig(views: PersonViews, cameras: tuple[Camera, ...], length: KnownLength) -> Rig:
    """The rig in metres without a check and with the first camera as the world: to look again, not to be kept."""
    return _scaled(views, cameras, solve_person_bundle(views, cameras), length)[0]


def calibrate_from_person(
    views: PersonViews, cameras: tuple[Camera, ...], length: KnownLength, upside_down: tuple[str, ...] = ()
) -> PersonCalibration:
    """Camera poses from a walking person; the floor is the plane of the feet.

    Args:
        cameras: in the order of the views.

    Raises:
        CalibrationError: input that cannot be used. RefusedCalibration (one of them, with the report): a check fails.
    """
    done = [check_person_in_views(views), check_same_video_by_person(views)]
    CalibrationReport(_SUBJECT, tuple(done)).require()
    solved = solve_person_bundle(views, cameras)
    solution, rows = solved.solution, solved.rows
    rig, xyz = _scaled(views, cameras, solved, length)
    distance_m = float(np.nanmedian(np.linalg.norm(rig.cameras[0].cam_from_world @ xyz.reshape(-1, 3), axis=1)))
    hips = xyz[:, views.skeleton.indices(_HIPS)].mean(axis=1)
    done += [*person_solution_checks(views.skeleton, cameras, solution, rows, rig, xyz), check_walk(hips, distance_m)]
    if CalibrationReport(_SUBJECT, tuple(done)).failed:
        CalibrationReport(_SUBJECT, (*likely_person_causes(views, cameras, solved), *done)).require()
    free = freed(cameras, solved, focal=True)
    done += [check_intrinsics(cameras, free), check_synchronised(cameras, free)]
    # the others take more solves, which do not help a rig that already fails
    CalibrationReport(_SUBJECT, tuple(done)).require()
    done.append(check_standing(cameras, solve_person_bundle(views, cameras, STANDING_POINTS, solved)))
    done.append(_check_halves(views, cameras, distance_m, length))
    rule = _floor(views.skeleton, xyz)
    residual = solution.residual_px[inliers(solution, rows)]
    rms_px = float(np.sqrt((residual**2).sum(axis=1).mean()))
    rig = replace(rig.moved(rule.new_from_old(rig)), world_set_by=rule.words, residual_px=rms_px)
    done += world_checks(rig, rule.has_floor, upside_down)
    report = CalibrationReport(
        _SUBJECT, tuple(done),
        numbers={"sigma_px": solution.sigma_px, "points": float(rows.point_count), "residual_px": rig.residual_px}
        | ({} if length.stature_m is None else {"scale_sigma_percent": 100 * STATURE_SIGMA}),
    )  # fmt: skip
    report.require()
    return PersonCalibration(rig, report)


def _scaled(views: PersonViews, cameras: tuple[Camera, ...], solved: PersonSolution, length: KnownLength) -> tuple[Rig, Array]:
    """The rig in metres and the person's keypoints (T, K, 3) in it."""
    pose = solved.solution.state.cam_from_world.se3()
    rig = Rig(tuple(replace(camera, cam_from_world=pose[i]) for i, camera in enumerate(cameras)))
    shape = views.xy_img.shape[1:3]
    xy = np.full(views.xy_img.shape, np.nan)
    good = views.usable
    xy[good] = views.xy_img[good]
    xyz = triangulate_linear(rig, xy.reshape(len(cameras), -1, 2)).reshape(*shape, 3)
    factor = length.scale(rig, views.skeleton, xyz)
    scaled = tuple(
        replace(camera, cam_from_world=SE3(camera.cam_from_world.wxyz, camera.cam_from_world.xyz * factor)) for camera in rig
    )
    return Rig(scaled), xyz * factor


def _floor(skeleton: Skeleton, xyz: Array) -> FloorFromFeet | FloorUnderBody:
    """The floor under keypoints (T, K, 3): under heels and toes, where the network has them."""

    def of(names: Sequence[str]) -> Array:
        there = [skeleton.index(name) for name in names if name in skeleton.keypoints]
        return xyz[:, there].reshape(-1, 3)

    soles, head = of(_SOLES), of(_HEADS)
    if np.isfinite(soles).all(axis=1).any():
        feet, above_m = soles, 0.0
    else:
        feet, above_m = of(_ANKLES), _ANKLE_SHARE * stature_m(skeleton, xyz)
    return (FloorFromFeet if spread_m(feet)[1] > _PLANE_M else FloorUnderBody)(feet, head, above_m)


def _check_halves(views: PersonViews, cameras: tuple[Camera, ...], distance_m: float, length: KnownLength) -> Check:
    """Solve from even and odd stretches of a tenth of the recording."""
    stretch = np.arange(len(views.t_ns)) * 10 // len(views.t_ns) % 2
    found = []
    for half in (0, 1):
        part = views.at(stretch == half)
        one, _ = _scaled(part, cameras, solve_person_bundle(part, cameras), length)
        found.append(Poses(np.stack([c.cam_from_world.matrix() for c in one]), np.stack([c.cam_from_world.xyz for c in one])))
    apart_m, turned = camera_differences(found[0], found[1])
    limit = _HALVES_SHARE * distance_m
    worst = int(np.argmax(np.maximum(apart_m / limit, turned / _HALVES_RAD)))
    return Check(
        "halves agree", bool((apart_m <= limit).all() and (turned <= _HALVES_RAD).all()),
        f"from separate data {cameras[worst].name} differs by {apart_m[worst] * 1e3:.0f} mm and"
        f" {np.rad2deg(turned[worst]):.2f} deg"
        f" apart (limits {limit * 1e3:.0f} mm, {np.rad2deg(_HALVES_RAD):.1f} deg)",
        "walk longer and over the whole floor, arms and legs moving",
    )  # fmt: skip
