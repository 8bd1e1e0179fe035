"""Why a rig from a person was refused: explanations solved against each other on the same keypoints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.calibration.report import Check
from posefuse.calibration.solving.point_solve import PointSolution, PointViews
from posefuse.core import CalibrationError, Camera

from .bundle import PersonSolution, freed, solve_person_bundle
from .checks import LEAST_INLIER_SHARE, agreeing_shares, check_intrinsics, check_synchronised
from .standing import STANDING_POINTS, check_standing
from .views import PersonViews

# an explanation leaves so much of the spread at most, and lets every camera agree
_MOST_LEFT = 0.8


def likely_person_causes(views: PersonViews, cameras: tuple[Camera, ...], solved: PersonSolution) -> tuple[Check, ...]:
    """The first explanation that makes all cameras agree, as a failed check; none where there is none.

    Tried are one camera's image flipped back, with and without its left and right, focal lengths and clocks let free, and cameras
    that move, each once.
    """
    shares = agreeing_shares(solved.solution, solved.rows, len(cameras))
    worst = int(np.argmin(shares))
    for flipped in (_flipped(views, cameras, worst, sides=False), _flipped(views, cameras, worst, sides=True)):
        try:
            again = solve_person_bundle(flipped, cameras, STANDING_POINTS)
        except CalibrationError:
            continue
        if _explains(again.solution, again.rows, solved, len(cameras)):
            words = f"the image of {cameras[worst].name} is mirrored"
            return (Check("cause", False, words, "switch the mirror mode of the camera off"),)
    free = freed(cameras, solved, focal=True)
    if _explains(free, solved.rows, solved, len(cameras)):
        failed = [check for check in (check_synchronised(cameras, free), check_intrinsics(cameras, free)) if not check.passed]
        return tuple(replace(check, name="cause") for check in failed[:1])
    standing = check_standing(cameras, solve_person_bundle(views, cameras, STANDING_POINTS, solved))
    return () if standing.passed else (replace(standing, name="cause"),)


def _explains(solution: PointSolution, rows: PointViews, before: PersonSolution, cameras: int) -> bool:
    alike = (agreeing_shares(solution, rows, cameras) >= LEAST_INLIER_SHARE).all()
    more = agreeing_shares(solution, rows, cameras).min() > agreeing_shares(before.solution, before.rows, cameras).min()
    return bool(alike and more and solution.sigma_px <= max(_MOST_LEFT * before.solution.sigma_px, 1.0))


def _flipped(views: PersonViews, cameras: tuple[Camera, ...], camera: int, *, sides: bool) -> PersonViews:
    """One camera's image flipped; `sides`: a network that names sides by their looks has swapped them, too."""
    xy = views.xy_img.copy()
    xy[camera] = xy[camera] * [-1, 1] + [cameras[camera].size_wh[0] - 1, 0]
    if not sides:
        return replace(views, xy_img=xy)
    score, sigma = views.score.copy(), views.sigma_px.copy()
    for values in (xy, score, sigma):
        values[camera] = values[camera][:, views.skeleton.mirror]
    return replace(views, xy_img=xy, score=score, sigma_px=sigma)
