"""What a rig from a person has to pass, and likely causes where it does not."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from posefuse.calibration.clocks.sync import person_seen
from posefuse.calibration.extrinsics.freedoms import check_clocks, standing_freed
from posefuse.calibration.extrinsics.prop_solve import SolvedRig, focal_change
from posefuse.calibration.extrinsics.self_checks import check_agreeing
from posefuse.calibration.report import Check
from posefuse.core import CalibrationError, Camera, Skeleton
from posefuse.core.arrays import Array

from .keypoint_solve import let_free, solve_person_bundle
from .views import PersonViews

_MOST_SIGMA_PX_PER_1000 = 12.0
_LEAST_INLIER_SHARE = 0.7
_LEAST_WALK_SHARE = 0.04
SAME_VIDEO_PX = 2.0
_LEAST_TRUE_SIDED = 0.5
# of free focal lengths and clocks: the best precision that a person allows, and standard errors
_FOCAL_SHARE, _LATE_S, _TERM_SIGMA = 0.05, 0.015, 6.0
_LEFTWARDS = (("right_shoulder", "right_hip"), ("left_shoulder", "left_hip"))
_UPWARDS = (("left_hip", "right_hip"), ("left_shoulder", "right_shoulder"))
_FORWARDS = (
    (("left_ear", "right_ear"), ("nose",)),
    (("left_heel",), ("left_foot_index",)), (("right_heel",), ("right_foot_index",)),
    (("left_heel",), ("left_big_toe",)), (("right_heel",), ("right_big_toe",)),
)  # fmt: skip


def check_person_in_views(views: PersonViews) -> Check:
    """Every camera saw the person."""
    return person_seen(views.cameras, np.asarray(views.usable.any(axis=2)), 5)


def fit_checks(solved: SolvedRig) -> list[Check]:
    """The keypoints fit, and the cameras agree."""
    sigma_px, width_px = solved.solution.sigma_px, max(max(camera.size_wh) for camera in solved.cameras)
    limit = _MOST_SIGMA_PX_PER_1000 * width_px / 1000
    return [
        Check("keypoints fit", sigma_px <= limit, f"spread {sigma_px:.1f} px (limit {limit:.1f})",
              "wrong intrinsics, cameras unsynchronised, or different people in different cameras"),
        check_agreeing(solved, _LEAST_INLIER_SHARE, 1, "it follows another person, moved, or is unsynchronised"),
    ]  # fmt: skip


def solution_fits(solved: SolvedRig) -> bool:
    """Whether the keypoints fit, and all cameras agree."""
    return all(check.passed for check in fit_checks(solved))


def check_walk(hips: Array, distance_m: float) -> Check:
    """The hips (T, 3) cover enough distance, relative to the distance of the cameras."""
    walked_m, least_m = float(spread_m(hips)[0]), _LEAST_WALK_SHARE * distance_m
    return Check(
        "the person walks about", walked_m >= least_m,
        f"the hips spread over {walked_m:.2f} m about their middle (needed {least_m:.2f})",
        "walk over the whole floor: a person who stays in one place does not determine where the cameras are",
    )  # fmt: skip


def check_mirror(skeleton: Skeleton, xyz: Array) -> Check:
    """Left, front and up of the keypoints (T, K, 3) lie as in a body."""
    share = true_sided(skeleton, xyz)
    return Check(
        "nothing is mirrored", share >= _LEAST_TRUE_SIDED,
        f"the person has left, front and up where they belong {share:.0%} of the time (needed {_LEAST_TRUE_SIDED:.0%})",
        "mirrored videos; or a person who stays in one place far away, which fits a mirrored room as well: walk about, come near",
    )  # fmt: skip


def check_intrinsics(free: SolvedRig) -> Check:
    """Focal lengths that are let free stay where they are."""
    cameras, (longer, sigma) = free.cameras, focal_change(free)
    limit = np.maximum(_FOCAL_SHARE, _TERM_SIGMA * sigma)
    wrong = np.flatnonzero(np.abs(longer) > limit)
    worst = int(np.argmax(np.abs(longer) / limit))
    named = wrong if len(wrong) else [worst]
    words = ", ".join(f"{cameras[c].name}'s focal length would rather be {longer[c]:+.1%} (standard error {sigma[c]:.1%}, limit"
                      f" {limit[c]:.0%})" for c in named)  # fmt: skip
    return Check("intrinsics fit", not len(wrong), words,
                 "focus or zoom has changed since they were calibrated, or they are of another camera or image size",
                 "lenses")  # fmt: skip


def check_synchronised(free: SolvedRig) -> Check:
    """Clocks that are let free stay where they are, as well as a person shows it."""
    return check_clocks(free, least=(_LATE_S, np.inf), sigmas=_TERM_SIGMA)


def true_sided(skeleton: Skeleton, xyz: Array) -> float:
    """Share of a body's keypoints (T, K, 3) over time in which left, front and up lie as they do in a body; NaN unknown.

    A body and a rig seen from afar fit the images nearly as well as their mirror images, whose left and right are swapped.
    """

    def between(ends: tuple[tuple[str, ...], tuple[str, ...]]) -> Array:
        first, second = (xyz[:, skeleton.indices(names)].mean(axis=1) for names in ends)
        return np.asarray(second - first)

    left, up = between(_LEFTWARDS), between(_UPWARDS)
    ways = [between(ends) for ends in _FORWARDS if all(name in skeleton.keypoints for names in ends for name in names)]
    volume = np.array([np.einsum("ti,ti->t", way, np.cross(left, up)) for way in ways])
    known = np.isfinite(volume)
    return float((volume[known] > 0).mean()) if known.any() else float("nan")


def spread_m(points: Array) -> Array:
    """(3,) standard deviations of points (N, 3) along their main directions, the widest first; strays left out."""
    known = points[np.isfinite(points).all(axis=1)]
    if len(known) == 0:
        return np.zeros(3)
    away = np.linalg.norm(known - np.median(known, axis=0), axis=1)
    near = known[away <= 3 * np.median(away)]
    return np.asarray(np.linalg.svd(near - near.mean(axis=0), compute_uv=False) / np.sqrt(len(near)))


# an explanation leaves so much of the spread at most, and lets every camera agree
_MOST_LEFT = 0.8


def likely_person_causes(views: PersonViews, solved: SolvedRig) -> tuple[Check, ...]:
    """The first explanation that makes all cameras agree, as a failed check; none where there is none.

    Tried are one camera's image flipped back, focal lengths and clocks let free, and cameras that move.
    """
    cameras, worst = solved.cameras, int(np.argmin(solved.agreeing()))
    with suppress(CalibrationError):
        again = solve_person_bundle(_flipped(views, cameras, worst), cameras, STANDING_POINTS)
        if _explains(again, solved):
            words = f"the image of {cameras[worst].name} is mirrored"
            return (Check("cause", False, words, "switch the mirror mode of the camera off"),)
    free = let_free(solved, focal=True)
    if _explains(free, solved):
        failed = [check for check in (check_synchronised(free), check_intrinsics(free)) if not check.passed]
        return tuple(replace(check, name="cause") for check in failed[:1])
    standing = check_standing(solve_person_bundle(views, cameras, STANDING_POINTS, solved))
    return () if standing.passed else (replace(standing, name="cause"),)


def _explains(solved: SolvedRig, before: SolvedRig) -> bool:
    less = solved.solution.sigma_px <= max(_MOST_LEFT * before.solution.sigma_px, 1.0)
    return less and solution_fits(solved) and not solution_fits(before)


def _flipped(views: PersonViews, cameras: tuple[Camera, ...], camera: int) -> PersonViews:
    """One camera's image flipped, and the sides, which a network names by their looks, swapped."""
    xy, score, sigma = views.xy_img.copy(), views.score.copy(), views.sigma_px.copy()
    xy[camera] = xy[camera] * [-1, 1] + [cameras[camera].size_wh[0] - 1, 0]
    for values in (xy, score, sigma):
        values[camera] = values[camera][:, views.skeleton.mirror]
    return replace(views, xy_img=xy, score=score, sigma_px=sigma)


# a camera moves from this angle on; and keypoints that are enough to see it
_LEAST_RAD, STANDING_POINTS = np.deg2rad(0.35), 1200


def check_standing(solved: SolvedRig) -> Check:
    """No camera moves during the recording."""
    return standing_freed(solved, _LEAST_RAD).check
