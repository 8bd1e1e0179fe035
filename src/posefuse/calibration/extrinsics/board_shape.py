"""Boards that are not as described: stretched in print, or bent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.report import Check
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .limits import Limits
from .pipeline import Solved
from .prop_solve import Freedom, PropSolution, solve_prop

# shares of the half size tried on both sides, first roughly, then about what was found
_STEPS, _FARTHEST = (0.02, 0.005), 0.1
DEFORMED_REMEDY = "print at 100 % in both directions, glue it to a flat plate, and measure it along both sides"


@dataclass(frozen=True)
class Deformation:
    """One way of being deformed: words (with the share, and millimetres), and shift (M, n, 3) of corners in half sizes."""

    words: str
    way: Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class Deformed:
    """The deformation that fits best: share of half the board's size, its standard error, and the solve with it."""

    words: str
    share: float
    sigma: float
    solution: PropSolution


STRETCHED = Deformation("longer in one direction than described: printed stretched by {0:+.1%}", lambda off: off * [0, 1, 0])
DEFORMATIONS = (
    STRETCHED,
    Deformation("not flat: bent across by {1:+.0f} mm", lambda off: np.square(off[..., :1]) * [0, 0, 1]),
    Deformation("not flat: bent along by {1:+.0f} mm", lambda off: np.square(off[..., 1:2]) * [0, 0, 1]),
)


def best_deformation(solved: Solved, cameras: tuple[Camera, ...], deformation: Deformation) -> Deformed | None:
    """By parabolas through three solves each; None where more deformation never fits worse."""
    corners = solved.corners
    middle, half = (corners.max(axis=(0, 1)) + corners.min(axis=(0, 1))) / 2, float(np.ptp(corners, axis=(0, 1)).max()) / 2
    way = deformation.way((corners - middle) / half)

    def solution_at(share: float) -> PropSolution:
        bent = replace(solved, corners=corners + share * half * way)
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
    return Deformed(deformation.words.format(share, share * half * 1e3), share, sigma, solution_at(share))


def _cost(solution: PropSolution, sigma_px: float) -> float:
    square = np.nan_to_num((solution.residual_px**2).sum(axis=1) / sigma_px**2, nan=1e3)
    return float((9 * np.log1p(square / 9)).sum())


def check_board_shape(solved: Solved, cameras: tuple[Camera, ...], limits: Limits) -> Check:
    """The board is as long in one direction as in the other, as described."""
    found = best_deformation(solved, cameras, STRETCHED)
    share, sigma = (0.0, 0.0) if found is None else (found.share, found.sigma)
    return Check(
        "board is as described", abs(share) <= max(limits.stretch_share, limits.lens_sigma * sigma),
        f"fits best as {share:+.2%} longer in one direction (standard error {sigma:.2%}, limit {limits.stretch_share:.0%})",
        DEFORMED_REMEDY,
    )  # fmt: skip
