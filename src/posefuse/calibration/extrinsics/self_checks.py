"""Self-checks of a rig solved from a prop: each states the value, the limit, and the next step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from posefuse.calibration.geometry import Poses, angle_between, centre_covariance_m2, nearest_rotation
from posefuse.calibration.report import LIMITS, CalibrationReport, Check
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.detection import BLURRED_EDGE_PX
from posefuse.calibration.targets.kinds import Charuco, Target, scale_m
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .freedoms import board_freed, camera_moves, check_lenses, clocks_freed, lens_change, lenses_freed
from .own_intrinsics import check_carried
from .pipeline import LEAST_TIME_STEPS, RigTask, Solved
from .prop_solve import SolvedRig

# two cameras that stand apart never see so many corners within this of each other
_SAME_VIDEO_CORNERS, _SAME_VIDEO_PX = 40, 1.0


def check_target_seen(observations: CornerObservations) -> Check:
    """Every camera saw the target."""
    views = np.bincount(observations.camera[observations.view_starts()], minlength=len(observations.cameras))
    blind = [f"{name} (0 of {n} frames)" for name, n, v in zip(observations.cameras, observations.frame_count, views, strict=True)
             if v == 0]  # fmt: skip
    detail = f"the target was not found by {', '.join(blind)}" if blind else "every camera saw the target"
    return Check("target seen", not blind, detail, "show it there, check focus, light and marker size, or leave the camera out")


def check_target_moves(observations: CornerObservations) -> Check:
    """The target is at more than one place: frames of one pose determine no more than one of them."""
    key = np.stack([observations.camera, observations.patch, observations.corner], axis=1)
    first, place, count = np.unique(key, axis=0, return_index=True, return_inverse=True, return_counts=True)[1:]
    place = place.ravel()
    middle = np.stack([np.bincount(place, xy) for xy in observations.xy_img.T], axis=1) / count[:, None]
    spread_px = np.sqrt(np.bincount(place, ((observations.xy_img - middle[place]) ** 2).sum(axis=1)) / count)
    width_px = np.array([max(wh) for wh in observations.sizes_wh])[observations.camera[first]]
    # a corner in a few images shows no motion, and that there are too few is another check's word
    often = count >= LEAST_TIME_STEPS
    share = float((spread_px / width_px)[often].max(initial=0.0))
    moves = not often.any() or share >= LIMITS.target_spread_share
    still = "" if moves else ": it is held still, and frames of one pose count as one"
    detail = f"corners spread by {share:.1%} of an image's width (needed {LIMITS.target_spread_share:.0%}){still}"
    return Check("target moves", moves, detail, "wave it through the whole volume")


def check_doubled(observations: CornerObservations) -> Check:
    """No marker comes twice in many images."""
    frames = dict(zip(observations.cameras, observations.frame_count, strict=True))
    often = [f"marker {m} in {n} frames of {c}" for c, m, n in observations.doubled if n > 0.05 * frames[c] and n > 5]
    return Check(
        "marker ids are unique", not often, f"met twice in one image: {'; '.join(often)}" if often else "no id comes twice",
        "two props or two faces carry the same id: take one away",
    )  # fmt: skip


def check_same_video_by_corners(observations: CornerObservations) -> Check:
    """No two cameras have the same image points at the same times."""
    key = np.stack([observations.t_ns, observations.patch, observations.corner], axis=1)
    place = np.unique(key, axis=0, return_inverse=True)[1].ravel()
    xy = np.full((len(observations.cameras), int(place.max(initial=-1)) + 1, 2), np.nan)
    xy[observations.camera, place] = observations.xy_img
    return check_videos_differ(observations.cameras, xy, _SAME_VIDEO_CORNERS, _SAME_VIDEO_PX)


def check_videos_differ(names: Sequence[str], xy_img: Array, least: int, most_px: float) -> Check:
    """No two cameras have `least` points or more of (C, ..., 2) in common, usually within `most_px` of each other."""
    alike = []
    for a, b in combinations(range(len(names)), 2):
        off = np.linalg.norm(xy_img[a] - xy_img[b], axis=-1)
        off = off[np.isfinite(off)]
        if len(off) >= least and float(np.median(off)) < most_px:
            alike.append(f"{names[a]} and {names[b]}")
    detail = f"{', '.join(alike)} show the same video" if alike else "no two cameras show the same"
    return Check("videos differ", not alike, detail, "give each camera its own video")


def check_sharp(observations: CornerObservations) -> Check:
    """What moves has sharp edges in the images of every camera."""
    blurred = [(name, px) for name, px in observations.edge_width_px if px > BLURRED_EDGE_PX]
    names = "all cameras" if len(blurred) == len(observations.cameras) else ", ".join(name for name, _ in blurred)
    widest_px = max((px for _, px in blurred), default=0.0)
    detail = f"the images of {names} are blurred: moving edges are {widest_px:.0f} px wide (limit"
    return Check(
        "images are sharp", not blurred, f"{detail} {BLURRED_EDGE_PX:.0f} px)" if blurred else "moving edges are sharp",
        "shorten the exposure time, add light, move the target more slowly, and check the focus",
    )  # fmt: skip


def check_fit(solved: Solved) -> Check:
    """The corners fit as well as detection can be trusted."""
    limit = LIMITS.corner_spread_px_per_1000 * max(max(camera.size_wh) for camera in solved.cameras) / 1000
    sigma = solved.solution.sigma_px
    return Check("corners fit", sigma <= limit, f"spread of a corner coordinate {sigma:.2f} px (limit {limit:.2f})",
                 "blur, cameras unsynchronised (try clocks = offset), wrong intrinsics, or a prop that bends")  # fmt: skip


def check_agreeing(solved: SolvedRig, least: float, parts: int, remedy: str) -> Check:
    """Every camera agrees with the others, by the share of its views in each of so many parts of the recording."""
    share = solved.agreeing(parts)
    worst, part = (int(i) for i in np.unravel_index(np.argmin(share), share.shape))
    when = f" in part {part + 1} of {parts} of the recording" if parts > 1 else ""
    detail = f"{solved.cameras[worst].name} agrees worst: {share[worst, part]:.0%} of its views{when} (needed {least:.0%})"
    return Check("cameras agree", bool(share[worst, part] >= least), detail, remedy)


def check_determined(solved: Solved) -> Check:
    """Standard errors of the camera positions are small."""
    sigma = position_sigma_m(solved)
    worst, limit = int(np.argmax(sigma)), LIMITS.position_sigma_share * float(np.median(solved.distance_m))
    return Check(
        "cameras are determined", bool(sigma[worst] <= limit),
        f"standard error of {solved.cameras[worst].name}'s position {sigma[worst] * 1e3:.1f} mm (limit {limit * 1e3:.1f}), its"
        " intrinsics taken as exact",
        "let this camera see the prop more often, nearer and together with others",
    )  # fmt: skip


def position_sigma_m(solved: Solved) -> Array:
    """(C,) standard error of each camera's centre against the reference camera, with exact intrinsics: a focal length that is
    wrong by a share moves its camera by about that share of the distance along its view.
    """
    return np.asarray(np.sqrt(np.trace(position_cov_m2(solved), axis1=-2, axis2=-1)))


def position_cov_m2(solved: Solved) -> Array:
    """(C, 3, 3) covariance of each camera's centre against the reference camera, in the frame of the solution."""
    return centre_covariance_m2(solved.solution.state.cam_from_world, solved.solution.camera_covariance)


def camera_differences(first: Poses, second: Poses) -> tuple[Array, Array]:
    """Distance (C,) m and angle (C,) rad between two sets of cam_from_world, after the best common rigid motion."""
    a, b = first.inverse(), second.inverse()
    turn = nearest_rotation((a.R @ np.swapaxes(b.R, 1, 2)).sum(axis=0))
    moved = (b.t - b.t.mean(axis=0)) @ turn.T
    return np.linalg.norm(a.t - a.t.mean(axis=0) - moved, axis=1), angle_between(a.R, turn @ b.R)


def check_facing(solved: Solved) -> Check:
    """The printed faces look at the cameras that see them: a mirrored board looks away, and so does one too small to show its
    slant, which would else be refused as undetermined (`tests/calibration/test_refusals.py`)."""
    seen, state = solved.seen, solved.solution.state
    first = seen.group_starts()
    world_from_patch = state.world_from_prop[seen.time_step[first]] @ state.prop_from_patch[seen.patch[first]]
    cam_from_patch = state.cam_from_world[seen.camera[first]] @ world_from_patch
    middle = np.stack([cam_from_patch.move(np.tile(corner, (len(first), 1))) for corner in solved.corners[0]]).mean(axis=0)
    facing = ((cam_from_patch.R[:, :, 2] * middle).sum(axis=1) < 0) & (middle[:, 2] > 0)
    share = {
        camera.name: float(facing[seen.camera[first] == c].mean())
        for c, camera in enumerate(solved.cameras)
        if (seen.camera[first] == c).any()
    }
    worst = min(share, key=lambda name: share[name])
    return Check(
        "nothing is mirrored", share[worst] >= LIMITS.facing_share,
        f"{share[worst]:.0%} of {worst}'s views see the printed face (needed {LIMITS.facing_share:.0%})",
        "the board is described mirrored, the image is flipped, or the markers are too small to show their slant",
    )  # fmt: skip


def check_cameras_apart(cameras: Sequence[Camera], cam_from_world: Poses) -> Check:
    """No two cameras share a body."""
    a, b, distance_m = nearest_two(cam_from_world.inverse().t)
    return Check(
        "cameras are apart", distance_m >= LIMITS.apart_m,
        f"{cameras[a].name} and {cameras[b].name} are nearest, {distance_m * 1e3:.0f} mm (needed {LIMITS.apart_m * 1e3:.0f})",
        "is one stream given twice?",
    )  # fmt: skip


def nearest_two(centres: Array) -> tuple[int, int, float]:
    """Which two of the points (C, 3) are nearest to each other, and their distance."""
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=-1) + np.eye(len(centres)) * 1e9
    a, b = (int(i) for i in np.unravel_index(np.argmin(distance), distance.shape))
    return a, b, float(distance[a, b])


def check_upright(cameras: Sequence[Camera], up_cam: Array) -> Check:
    """No camera is upside down against the world's up (C, 3) in camera axes."""
    cosine = -up_cam[:, 1] / np.maximum(np.linalg.norm(up_cam[:, :2], axis=1), 1e-9)
    # a camera that looks straight up or down has no top
    cosine = np.where(np.linalg.norm(up_cam[:, :2], axis=1) < 0.2, 1.0, cosine)
    wrong = [camera.name for camera, value in zip(cameras, cosine, strict=True) if value < LIMITS.upside_down_cosine]
    return Check(
        "images are upright", not wrong, f"upside down: {', '.join(wrong)}" if wrong else "the top of every image is up",
        "turn the image; for a camera that is mounted upside down, name it with `upside_down=CAMERA`",
    )  # fmt: skip


def halves(solved: Solved) -> tuple[Solved, ...]:
    """Solved from the first and from the second half of the time steps, sharing no data; from every other tenth where a camera
    has too few views in one of the halves, and none where it has them in neither."""
    seen, used = solved.seen, np.unique(solved.seen.time_step)
    for stretches in (2, 10):
        half = np.searchsorted(used, seen.time_step) * stretches // max(len(used), 1) % 2
        parts = [seen.rows(half == i) for i in (0, 1)]
        views = [np.bincount(part.camera[part.group_starts()], minlength=len(solved.cameras)) for part in parts]
        if np.min(views) >= LEAST_TIME_STEPS:
            return tuple(replace(solved, seen=part).again() for part in parts)
    return ()


_MM = 1000.0
UNITS = "sizes are millimetres on the command line, metres in Python"


def _edge(target: Target) -> str:
    return "square" if isinstance(target, Charuco) else "marker side"


def check_target_size(target: Target) -> Check:
    """A marker or square can be printed and carried."""
    side_m, (least_m, most_m) = scale_m(target), LIMITS.target_side_m
    return Check(
        "target has a plausible size", least_m <= side_m <= most_m,
        f"{_edge(target)} {side_m * _MM:g} mm (expected {least_m * _MM:g} to {most_m * _MM:g} mm)",
        f"check the unit: {UNITS}",
    )  # fmt: skip


def check_rig_size(task: RigTask, solved: Solved) -> Check:
    """Target and cameras are as far from each other as in a room in which a person moves."""
    cameras, target, distance_m = solved.cameras, task.target, float(np.median(solved.distance_m))
    a, b, apart_m = nearest_two(solved.solution.state.cam_from_world.inverse().t)
    least_m, most_m = LIMITS.distance_m
    return Check(
        "rig has a plausible size", task.options.any_size or least_m <= distance_m <= most_m,
        f"with a {_edge(target)} of {scale_m(target) * _MM:g} mm the target was {distance_m:.2f} m from the cameras, and"
        f" {cameras[a].name} and {cameras[b].name} are {apart_m:.2f} m apart"
        f" (expected a distance of {least_m:g} to {most_m:g} m)",
        f"measure the print: {UNITS}; for a rig that really has this size add `any_size=True`",
    )  # fmt: skip


def solution_checks(task: RigTask, solved: Solved) -> list[Check]:
    """All checks of a solution; raises RefusedCalibration after the quick ones, since the others take further solves."""
    synchronised = task.options.clocks == "together"
    determined = check_determined(solved)
    quick = [
        *([check_carried(task.observations, solved)] if task.options.own_intrinsics else []),
        check_agreeing(solved, LIMITS.agreeing_share, LIMITS.agreeing_parts, "it was moved, is late, or has wrong times"),
        check_facing(solved),
        check_fit(solved),
        determined,
        check_cameras_apart(solved.cameras, solved.solution.state.cam_from_world),
        check_rig_size(task, solved),
    ]
    if synchronised and [check for check in quick if not check.passed] == [determined]:
        # a camera that is late spreads the corners, and the poses with them
        quick.append(clocks_freed(solved).check)
    CalibrationReport("extrinsics", tuple(quick)).require()
    parts = [lens_change(half, lenses_freed(half, False)) for half in halves(solved)]
    lenses = lens_change(solved, lenses_freed(solved, not synchronised)).confirmed_by(parts)
    done = [*quick, camera_moves(solved.thinned).check, check_lenses(lenses)]
    if isinstance(task.target, Charuco):
        done.append(board_freed(solved.thinned).check)
    if synchronised:
        done.append(clocks_freed(solved).check)
    return done
