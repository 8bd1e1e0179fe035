"""What a rig from a person has to pass, and likely causes where it does not."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from itertools import combinations

import numpy as np

from posefuse.calibration.clocks.person import person_seen
from posefuse.calibration.extrinsics import self_checks
from posefuse.calibration.report import Check
from posefuse.calibration.solving.point_solve import FOCAL, LATE, PointSolution, PointViews
from posefuse.calibration.solving.rotations import poses_of
from posefuse.core import CalibrationError, Camera, Rig, Skeleton
from posefuse.core.arrays import Array

from .bundle import PersonSolution, freed, solve_person_bundle
from .standing import STANDING_POINTS, check_standing
from .views import PersonViews

_MOST_SIGMA_PX_PER_1000 = 12.0
_LEAST_INLIER_SHARE, _INLIER_SIGMA = 0.7, 4.0
_LEAST_WALK_SHARE = 0.04
_SAME_VIDEO_PX = 2.0
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
    seen = views.usable.any(axis=2).sum(axis=1)
    blind = [f"{name} ({n} of {len(views.t_ns)} frames)" for name, n in zip(views.cameras, seen, strict=True) if n < 5]
    return person_seen(blind)


def check_same_video_by_person(views: PersonViews) -> Check:
    """No two cameras have the person at the same pixels all the time."""
    alike = []
    for a, b in combinations(range(len(views.cameras)), 2):
        off = np.linalg.norm(views.xy_img[a] - views.xy_img[b], axis=-1)
        if np.isfinite(off).any() and float(np.nanmedian(off)) < _SAME_VIDEO_PX:
            alike.append(f"{views.cameras[a]} and {views.cameras[b]}")
    return self_checks.videos_differ(alike)


def person_solution_checks(
    skeleton: Skeleton, cameras: tuple[Camera, ...], solution: PointSolution, rows: PointViews, rig: Rig, xyz: Array
) -> list[Check]:
    """The keypoints fit, the cameras agree, nothing is mirrored, and no two cameras share a place."""
    limit, share = _spread_limit_px(cameras), agreeing_shares(solution, rows, len(cameras))
    worst = int(np.argmin(share))
    return [
        Check("keypoints fit", solution.sigma_px <= limit, f"spread {solution.sigma_px:.1f} px (limit {limit:.1f})",
              "wrong intrinsics, cameras unsynchronised, or different people in different cameras"),
        Check("cameras agree", bool(share[worst] >= _LEAST_INLIER_SHARE),
              f"{cameras[worst].name} agrees worst: {share[worst]:.0%} of its keypoints (needed {_LEAST_INLIER_SHARE:.0%})",
              "it follows another person, moved, or is unsynchronised"),
        check_mirror(skeleton, xyz),
        self_checks.check_cameras_apart(cameras, poses_of(rig)),
    ]  # fmt: skip


def solution_fits(cameras: tuple[Camera, ...], solution: PointSolution, rows: PointViews) -> bool:
    """Whether the keypoints fit, and all cameras agree."""
    agree = (agreeing_shares(solution, rows, len(cameras)) >= _LEAST_INLIER_SHARE).all()
    return bool(agree and solution.sigma_px <= _spread_limit_px(cameras))


def _spread_limit_px(cameras: tuple[Camera, ...]) -> float:
    return _MOST_SIGMA_PX_PER_1000 * max(max(camera.size_wh) for camera in cameras) / 1000


def agreeing_shares(solution: PointSolution, rows: PointViews, cameras: int) -> Array:
    """(C,) share of each camera's keypoints that agree."""
    good = inliers(solution, rows)
    return np.array([good[rows.camera == c].mean() if (rows.camera == c).any() else 0.0 for c in range(cameras)])


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


def check_intrinsics(cameras: tuple[Camera, ...], free: PointSolution) -> Check:
    """Focal lengths that are let free stay where they are."""
    longer, sigma = free.state.terms[:, FOCAL], free.terms_sigma[:, FOCAL]
    limit = np.maximum(_FOCAL_SHARE, _TERM_SIGMA * sigma)
    wrong = np.flatnonzero(np.abs(longer) > limit)
    worst = int(np.argmax(np.abs(longer) / limit))
    named = wrong if len(wrong) else [worst]
    words = ", ".join(f"{cameras[c].name}'s focal length would rather be {longer[c]:+.1%} (standard error {sigma[c]:.1%}, limit"
                      f" {limit[c]:.0%})" for c in named)  # fmt: skip
    return Check("intrinsics fit", not len(wrong), words,
                 "focus or zoom has changed since they were calibrated, or they are of another camera or image size",
                 "lenses")  # fmt: skip


def check_synchronised(cameras: tuple[Camera, ...], free: PointSolution) -> Check:
    """Clocks that are let free stay where they are."""
    late_s, sigma_s = free.state.terms[:, LATE], free.terms_sigma[:, LATE]
    late_s = late_s - np.median(late_s)
    ratio = np.abs(late_s) / np.maximum(_LATE_S, _TERM_SIGMA * np.maximum(sigma_s, np.median(sigma_s)))
    worst = int(np.argmax(ratio))
    return Check(self_checks.IN_STEP, bool(ratio[worst] <= 1),
                 f"the clock of {cameras[worst].name} is {late_s[worst] * 1e3:+.0f} ms late (standard error"
                 f" {sigma_s[worst] * 1e3:.1f} ms, limit {_LATE_S * 1e3:.0f} ms)",
                 "the cameras are not synchronised: calibrate with `clocks=offset`", "clocks")  # fmt: skip


def true_sided(skeleton: Skeleton, xyz: Array) -> float:
    """Share of a body's keypoints (T, K, 3) over time in which left, front and up lie as they do in a body; NaN unknown.

    A body and a rig seen from afar fit the images nearly as well as their mirror images, whose left and right are exchanged.
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


def inliers(solution: PointSolution, rows: PointViews) -> Array:
    """(N,) whether a row lies within 4 robust standard deviations, as noisy as it is itself."""
    size = np.abs(solution.residual_px).max(axis=1) / rows.relative_sigma
    return np.asarray(size <= _INLIER_SIGMA * solution.sigma_px)


# an explanation leaves so much of the spread at most, and lets every camera agree
_MOST_LEFT = 0.8


def likely_person_causes(views: PersonViews, cameras: tuple[Camera, ...], solved: PersonSolution) -> tuple[Check, ...]:
    """The first explanation that makes all cameras agree, as a failed check; none where there is none.

    Tried are one camera's image flipped back, focal lengths and clocks let free, and cameras that move.
    """
    worst = int(np.argmin(agreeing_shares(solved.solution, solved.rows, len(cameras))))
    with suppress(CalibrationError):
        again = solve_person_bundle(_flipped(views, cameras, worst), cameras, STANDING_POINTS)
        if _explains(cameras, again.solution, again.rows, solved):
            words = f"the image of {cameras[worst].name} is mirrored"
            return (Check("cause", False, words, "switch the mirror mode of the camera off"),)
    free = freed(cameras, solved, focal=True)
    if _explains(cameras, free, solved.rows, solved):
        failed = [check for check in (check_synchronised(cameras, free), check_intrinsics(cameras, free)) if not check.passed]
        return tuple(replace(check, name="cause") for check in failed[:1])
    standing = check_standing(cameras, solve_person_bundle(views, cameras, STANDING_POINTS, solved))
    return () if standing.passed else (replace(standing, name="cause"),)


def _explains(cameras: tuple[Camera, ...], solution: PointSolution, rows: PointViews, before: PersonSolution) -> bool:
    less = solution.sigma_px <= max(_MOST_LEFT * before.solution.sigma_px, 1.0)
    return less and solution_fits(cameras, solution, rows) and not solution_fits(cameras, before.solution, before.rows)


def _flipped(views: PersonViews, cameras: tuple[Camera, ...], camera: int) -> PersonViews:
    """One camera's image flipped, and the sides, which a network names by their looks, exchanged."""
    xy, score, sigma = views.xy_img.copy(), views.score.copy(), views.sigma_px.copy()
    xy[camera] = xy[camera] * [-1, 1] + [cameras[camera].size_wh[0] - 1, 0]
    for values in (xy, score, sigma):
        values[camera] = values[camera][:, views.skeleton.mirror]
    return replace(views, xy_img=xy, score=score, sigma_px=sigma)
