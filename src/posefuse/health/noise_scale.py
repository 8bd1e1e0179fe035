"""How much larger or smaller the errors of a network are than its noise states, from what cameras disagree on.

The Birge ratio (Birge 1932, "The calculation of errors by the method of least squares"): the root of chi-square over its degrees
of freedom. Here it is a median over joints and time steps whose views agree. Errors that all cameras share are not seen by it.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from posefuse.core import Rig
from posefuse.core.arrays import Array
from posefuse.fusion import FuseSettings, triangulate

# fewer joints in a time step, seen by enough cameras, say nothing; and beyond these limits it is not the noise that is wrong
_LEAST_SEEN = 200
_LIMITS = (0.5, 3.0)


def disagreement(rig: Rig, xy_img: Array, score: Array, sigma_px: Array, fusing: FuseSettings) -> Array:
    """(R,) of every point whose views all agree: chi-square of its residuals over the median that is expected.

    Args:
        xy_img: (..., C, K, 2) views of the points. score, sigma_px: (..., C, K).
    """
    solved = triangulate(rig, xy_img, score, sigma_px, settings=fusing)
    off = (xy_img - np.moveaxis(rig.project(solved.xyz), 0, -3)) / sigma_px[..., None]
    used: Array = np.isfinite(off).all(axis=-1) & (score >= fusing.score_min)
    count = used.sum(axis=-2)
    # coordinates that were seen less those of the point
    freedom = 2 * count - 3
    known = (freedom > 0) & (count == solved.n_views)
    chi2 = (np.where(used[..., None], off, 0.0) ** 2).sum(axis=(-3, -1))[known]
    return np.asarray(chi2 / (2 * gammaincinv(freedom[known] / 2, 0.5)))


def noise_scale(shares: Array) -> float | None:
    """By what the stated standard deviations are to be multiplied, from 0.5 to 3; None where too little is seen."""
    return float(np.clip(np.sqrt(np.median(shares)), *_LIMITS)) if len(shares) >= _LEAST_SEEN else None
