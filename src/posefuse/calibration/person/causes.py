"""Why a rig from a person was refused: explanations solved against each other on the same keypoints."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from posefuse.calibration.report import Check
from posefuse.calibration.solving.point_solve import PointSolution, PointViews
from posefuse.core import CalibrationError, Camera

from .bundle import PersonSolution, freed, solve_person_bundle
from .checks import agreeing_shares, check_intrinsics, check_synchronised, solution_fits
from .standing import STANDING_POINTS, check_standing
from .views import PersonViews

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
