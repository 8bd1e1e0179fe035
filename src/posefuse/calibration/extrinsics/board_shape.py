"""Boards that are not as described: stretched in print."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.report import Check
from posefuse.core import Camera

from .limits import Limits
from .pipeline import Solved
from .prop_solve import Freedom, PropSolution, solve_prop

# shares tried on both sides, first roughly, then about what was found
_STEPS, _FARTHEST = (0.02, 0.005), 0.1
STRETCHED_REMEDY = "print at 100 % in both directions, glue it to a flat plate, and measure it along both sides"


@dataclass(frozen=True, eq=False)
class Stretch:
    """How much longer a board is in one direction than described (share), its standard error, and the solve with it."""

    share: float
    sigma: float
    solution: PropSolution


def best_stretch(solved: Solved, cameras: tuple[Camera, ...]) -> Stretch | None:
    """By parabolas through three solves each; None where more of it never fits worse."""
    corners = solved.corners
    middle = (corners.max(axis=(0, 1)) + corners.min(axis=(0, 1))) / 2

    def solution_at(share: float) -> PropSolution:
        bent = replace(solved, corners=corners + share * (corners - middle) * [0, 1, 0])
        freedom = Freedom(reference=solved.links.reference, held_patches=solved.links.shape.held)
        return solve_prop(bent.seen, bent.corners, cameras, solved.solution.state, freedom)

    share, sigma = 0.0, 0.0
    for step in _STEPS:
        tried = [solution_at(share + k * step) for k in (-1, 0, 1)]
        low, level, high = (_cost(one, min(other.sigma_px for other in tried)) for one in tried)
        curve = low + high - 2 * level
        if curve <= 0:
            return None
        share = float(np.clip(share + step * (low - high) / (2 * curve), -_FARTHEST, _FARTHEST))
        # the cost is twice the negative logarithm of the likelihood
        sigma = float(step * np.sqrt(2 / curve))
    return Stretch(share, sigma, solution_at(share))


def _cost(solution: PropSolution, sigma_px: float) -> float:
    square = np.nan_to_num((solution.residual_px**2).sum(axis=1) / sigma_px**2, nan=1e3)
    return float((9 * np.log1p(square / 9)).sum())


def check_board_shape(solved: Solved, cameras: tuple[Camera, ...], limits: Limits) -> Check:
    """The board is as long in one direction as in the other, as described."""
    found = best_stretch(solved, cameras)
    share, sigma = (0.0, 0.0) if found is None else (found.share, found.sigma)
    return Check(
        "board is as described", abs(share) <= max(limits.stretch_share, limits.lens_sigma * sigma),
        f"fits best as {share:+.2%} longer in one direction (standard error {sigma:.2%}, limit {limits.stretch_share:.0%})",
        STRETCHED_REMEDY, "input",
    )  # fmt: skip
