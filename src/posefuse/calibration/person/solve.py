"""Where the cameras are, from one walking person alone: 2D keypoints, intrinsics, and one known length for the scale.

A rough answer first (`keypoint_solve.first_poses`), then one robust bundle adjustment over all cameras and keypoints. The same
checks as for a prop stand between this and a rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.clocks.person_tracks import PersonTrack
from posefuse.calibration.clocks.start import rough_clocks_unplaced
from posefuse.calibration.clocks.sync import (
    LATE_SIGMA,
    MOST_JUMP_S,
    SUBJECT,
    ClockEstimate,
    check_clocks_determined,
    check_linked,
    check_one_offset,
    check_person_in_tracks,
    middle_s,
    moving_keypoints,
)
from posefuse.calibration.extrinsics.prop_solve import SolvedRig
from posefuse.calibration.extrinsics.self_checks import camera_differences, check_cameras_apart, check_videos_differ
from posefuse.calibration.extrinsics.target import world_checks
from posefuse.calibration.extrinsics.world import WorldRule, floor_from_feet, floor_under_body, triangulate_linear
from posefuse.calibration.geometry import poses_of
from posefuse.calibration.report import CalibrationReport, Check, RefusedCalibration
from posefuse.core import SE3, CalibrationError, Camera, Rig, Skeleton
from posefuse.core.arrays import Array

from .checks import (
    SAME_VIDEO_PX,
    STANDING_POINTS,
    check_intrinsics,
    check_mirror,
    check_person_in_views,
    check_standing,
    check_synchronised,
    check_walk,
    fit_checks,
    likely_person_causes,
    solution_fits,
    spread_m,
)
from .keypoint_solve import let_free, solve_person_bundle
from .scale import STATURE_SIGMA, KnownLength, stature_m
from .views import PersonViews, person_views

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
    return _scaled(views, solve_person_bundle(views, cameras), length)[0]


def calibrate_from_person(
    views: PersonViews, cameras: tuple[Camera, ...], length: KnownLength, upside_down: tuple[str, ...] = ()
) -> PersonCalibration:
    """Camera poses from a walking person; the floor is the plane of the feet.

    Args:
        cameras: in the order of the views.

    Raises:
        CalibrationError: input that cannot be used. RefusedCalibration (one of them, with the report): a check fails.
    """
    done = [check_person_in_views(views), check_videos_differ(views.cameras, views.xy_img, 1, SAME_VIDEO_PX)]
    CalibrationReport(_SUBJECT, tuple(done)).require()
    solved = solve_person_bundle(views, cameras)
    rig, xyz = _scaled(views, solved, length)
    distance_m = float(np.nanmedian(np.linalg.norm(rig.cameras[0].cam_from_world @ xyz.reshape(-1, 3), axis=1)))
    hips = xyz[:, views.skeleton.indices(_HIPS)].mean(axis=1)
    done += [*fit_checks(solved), check_mirror(views.skeleton, xyz), check_cameras_apart(cameras, poses_of(rig))]
    done.append(check_walk(hips, distance_m))
    if CalibrationReport(_SUBJECT, tuple(done)).failed:
        CalibrationReport(_SUBJECT, (*likely_person_causes(views, solved), *done)).require()
    free = let_free(solved, focal=True)
    done += [check_intrinsics(free), check_synchronised(free)]
    # the others take more solves, which do not help a rig that already fails
    CalibrationReport(_SUBJECT, tuple(done)).require()
    done.append(check_standing(solve_person_bundle(views, cameras, STANDING_POINTS, solved)))
    done.append(_check_halves(views, cameras, distance_m, length))
    rule = _floor(views.skeleton, xyz)
    residual = solved.solution.residual_px[solved.inlier[solved.seen.group]]
    rms_px = float(np.sqrt((residual**2).sum(axis=1).mean()))
    rig = replace(rig.moved(rule.new_from_old(rig)), world_set_by=rule.words, residual_px=rms_px)
    done += world_checks(rig, rule.has_floor, upside_down)
    report = CalibrationReport(
        _SUBJECT, tuple(done),
        numbers={"sigma_px": solved.solution.sigma_px, "points": float(len(solved.seen.t_s)), "residual_px": rig.residual_px}
        | ({} if length.stature_m is None else {"scale_sigma_percent": 100 * STATURE_SIGMA}),
    )  # fmt: skip
    report.require()
    return PersonCalibration(rig, report)


def _scaled(views: PersonViews, solved: SolvedRig, length: KnownLength) -> tuple[Rig, Array]:
    """The rig in metres and the person's keypoints (T, K, 3) in it."""
    cameras, pose = solved.cameras, solved.solution.state.cam_from_world.se3()
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


def _floor(skeleton: Skeleton, xyz: Array) -> WorldRule:
    """The floor under keypoints (T, K, 3): under heels and toes, where the network has them."""

    def of(names: Sequence[str]) -> Array:
        there = [skeleton.index(name) for name in names if name in skeleton.keypoints]
        return xyz[:, there].reshape(-1, 3)

    soles, head = of(_SOLES), of(_HEADS)
    if np.isfinite(soles).all(axis=1).any():
        feet, above_m = soles, 0.0
    else:
        feet, above_m = of(_ANKLES), _ANKLE_SHARE * stature_m(skeleton, xyz)
    if spread_m(feet)[1] > _PLANE_M:
        return WorldRule("floor under the feet", True, lambda rig: floor_from_feet(feet, head, above_m))
    return WorldRule("up along the body, floor under the feet", True, lambda rig: floor_under_body(feet, head, above_m))


def _check_halves(views: PersonViews, cameras: tuple[Camera, ...], distance_m: float, length: KnownLength) -> Check:
    """Solve from even and odd stretches of a tenth of the recording.

    Of ten wrong rigs from short walks with much noise it alone refuses three, the worst of them, by 190 mm, included.
    """
    stretch = np.arange(len(views.t_ns)) * 10 // len(views.t_ns) % 2
    found = []
    for half in (0, 1):
        part = views.at(stretch == half)
        found.append(poses_of(_scaled(part, solve_person_bundle(part, cameras), length)[0]))
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


_MOST_ROUNDS, _SETTLED_S = 6, 3e-4
# clocks need fewer keypoints than poses
_POINTS = 1200


def unplaced_clocks(
    tracks: Sequence[PersonTrack], cameras: tuple[Camera, ...], length: KnownLength, clocks: str, most_s: float
) -> ClockEstimate | None:
    """First estimate of the cameras' clocks from the person; None where they are synchronised, or assumed to be.

    Args:
        tracks: one per camera. clocks: one of `CLOCK_MODES` of a prop, and read as there.
        most_s: the farthest two cameras' clocks may be apart.

    Raises:
        CalibrationError: the person does not determine them; RefusedCalibration where a check fails.
    """
    if clocks == "together":
        return None
    names, moving = [track.camera for track in tracks], [moving_keypoints(track) for track in tracks]
    CalibrationReport(SUBJECT, (check_person_in_tracks(names, moving),)).require()
    zero = ClockEstimate.known(np.zeros(len(tracks)), middle_s(tracks))
    if clocks == "auto" and _synchronised(tracks, cameras):
        return None
    near: ClockEstimate | None = None
    with suppress(CalibrationError):
        near, solved = _settled(tracks, cameras, zero, clocks == "drift")
        if solution_fits(solved):
            return near
    # farther apart than the steps of a solve reach
    rough = rough_clocks_unplaced(cameras, moving, most_s)
    linked = check_linked(names, rough, most_s)
    report = CalibrationReport(SUBJECT, (check_one_offset(names, rough) if linked.passed else linked,))
    if report.failed and clocks == "auto":
        # what is wrong with them as their stamps are comes first
        try:
            calibrate_from_person(person_views(tracks), cameras, length)
        except RefusedCalibration as refused:
            raise RefusedCalibration(replace(refused.report, checks=(*refused.report.checks, *report.failed))) from None
    report.require()
    start = ClockEstimate.known(rough.offset_s, zero.middle_s)
    # not once more from where it began before
    return near if near is not None and not start.offset_s.any() else _settled(tracks, cameras, start, clocks == "drift")[0]


def at_clocks(tracks: Sequence[PersonTrack], clocks: ClockEstimate) -> tuple[PersonTrack, ...]:
    """The tracks with their stamps corrected, as `calibrate_tracks` takes them."""
    return tuple(replace(track, t_ns=1e9 * clocks.taken_s(c, track.t_s)) for c, track in enumerate(tracks))


def _synchronised(tracks: Sequence[PersonTrack], cameras: tuple[Camera, ...]) -> bool:
    """Whether a rig fits the cameras as their stamps are, and clocks that are let free stay."""
    with suppress(CalibrationError):
        solved = solve_person_bundle(person_views(tracks), cameras, _POINTS)
        return solution_fits(solved) and check_synchronised(let_free(solved, focal=True)).passed
    return False


def calibrate_tracks(
    tracks: Sequence[PersonTrack],
    cameras: tuple[Camera, ...],
    length: KnownLength,
    first: ClockEstimate | None,
    with_drift: bool,
    upside_down: tuple[str, ...] = (),
) -> tuple[PersonCalibration, ClockEstimate | None]:
    """The rig, and the clocks where the cameras are not synchronised.

    Args:
        tracks: one per camera, corrected by the clocks that were found first. first: these; None for synchronised cameras.

    Raises:
        CalibrationError: as `calibrate_from_person`. RefusedCalibration (one of them, with the report): a check fails.
    """
    if first is None:
        return calibrate_from_person(person_views(tracks), cameras, length, upside_down), None
    names = [track.camera for track in tracks]
    both, solved = _settled(tracks, cameras, ClockEstimate.known(np.zeros(len(tracks)), middle_s(tracks)), with_drift)
    found = calibrate_from_person(person_views(tracks, both), cameras, length, upside_down)
    apart_s = _halves_apart_s(tracks, cameras, both)
    # clocks absorb errors of the rig: two halves with separate rigs show that, the residuals of the fit do not
    shared_s = np.maximum(np.sqrt((apart_s[1:] ** 2).mean()), np.abs(apart_s)) / 2
    sigma_s = np.where(np.arange(len(tracks)) > 0, np.hypot(both.offset_sigma_s, shared_s), 0.0)
    left = replace(both, offset_sigma_s=sigma_s)
    checks = [check_clocks_determined(names, left)]
    if not with_drift:
        checks.append(_check_steady(let_free(solved, drift=True)))
    report = replace(found.report, checks=(*found.report.checks, *checks))
    report.require()
    return replace(found, report=report), first.then(left)


def _halves_apart_s(tracks: Sequence[PersonTrack], cameras: tuple[Camera, ...], clocks: ClockEstimate) -> Array:
    """(C,) difference between the clocks of the first and the second half of the recording, each solved with a separate rig."""
    offsets = []
    for second in (False, True):
        part = []
        for c, track in enumerate(tracks):
            t_s = clocks.taken_s(c, track.t_ns / 1e9)
            part.append(track.at((t_s >= clocks.middle_s) == second))
        offsets.append(_settled(part, cameras, clocks, False)[0].offset_s)
    return np.asarray(offsets[1] - offsets[0])


def _check_steady(free: SolvedRig) -> Check:
    """Clock rates that are let free stay where they are: against the median, since the held one may be the one that drifts."""
    drift, sigma = free.solution.state.delay_s[:, 1], free.solution.delay_sigma_s[:, 1]
    half_s = -float(free.seen.t_s.min())
    apart_s = (drift - np.median(drift)) * half_s
    limit_s = np.maximum(MOST_JUMP_S, LATE_SIGMA * np.maximum(sigma, np.median(sigma)) * half_s)
    c = int(np.argmax(np.abs(apart_s) / limit_s))
    return Check(
        "parts agree", bool(abs(apart_s[c]) <= limit_s[c]),
        f"{free.cameras[c].name} runs {apart_s[c] * 1e3:+.1f} ms later in the second half than in the first"
        f" (limit {limit_s[c] * 1e3:.1f})",
        "its clock runs at another rate: try `clocks=drift`; or frames were lost, or come at no constant rate, without a note in"
        " its file: use the part before or after",
    )  # fmt: skip


def _settled(
    tracks: Sequence[PersonTrack], cameras: tuple[Camera, ...], start: ClockEstimate, with_drift: bool
) -> tuple[ClockEstimate, SolvedRig]:
    """Poses and clocks in one solve, and the views read again at the clocks found, until these stay; and the last solve."""
    clocks, near = start, None
    for _ in range(_MOST_ROUNDS):
        views = person_views(tracks, clocks)
        solved = solve_person_bundle(views, cameras, _POINTS, near)
        near = let_free(solved, drift=with_drift)
        left = _left(near, clocks.middle_s)
        clocks = clocks.then(left)
        if np.abs(left.offset_s).max() < _SETTLED_S:
            break
    return clocks, solved


def _left(free: SolvedRig, middle_s: float) -> ClockEstimate:
    """What is left of clocks and their rates, against the first camera."""
    delay_s, sigma = free.solution.state.delay_s, free.solution.delay_sigma_s
    apart, sigma = delay_s - delay_s[0], np.hypot(sigma, sigma[0])
    sigma[0] = 0
    (offset_s, drift), (offset_sigma_s, drift_sigma) = apart.T, sigma.T
    return ClockEstimate(offset_s, drift, offset_sigma_s, drift_sigma, middle_s)
