"""How an error of place grows with the way walked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import Array

_LEAST_POINTS = 10


@dataclass(frozen=True, eq=False)
class Drift:
    """Error against way.

    Attributes:
        walked_m: (T,) way so far, of the truth. error_m: (T,) level distance from the truth.
        mm_per_m: slope of the least-squares line of error over way. end_m: mean error of the last tenth.
    """

    walked_m: Array
    error_m: Array
    mm_per_m: float
    end_m: float


def drift(estimate: Array, truth: Array) -> Drift:
    """Drift of level positions (T, 2 or 3) against the truth (T, 2 or 3), both in metres; NaN where missing."""
    error = np.linalg.norm(estimate[:, :2] - truth[:, :2], axis=-1)
    walked = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth[:, :2], axis=0), axis=-1))])
    known = np.isfinite(error)
    slope = float("nan")
    if known.sum() >= _LEAST_POINTS and np.ptp(walked[known]) > 0:
        slope = 1000 * float(np.polyfit(walked[known], error[known], 1)[0])
    last = error[-max(1, len(error) // 10) :]
    end = float(np.nanmean(last)) if np.isfinite(last).any() else float("nan")
    return Drift(walked, error, slope, end)
