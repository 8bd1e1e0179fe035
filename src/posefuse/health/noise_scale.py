"""How much larger or smaller the errors of a network are than its noise states, from what cameras disagree on.

The Birge ratio (Birge 1932, "The calculation of errors by the method of least squares"): the root of chi-square over its degrees
of freedom. Here it is a median over joints and time steps whose views agree. Errors that all cameras share are not seen by it.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from posefuse.core import Rig
from posefuse.core.arrays import Array

# fewer joints in a time step, seen by enough cameras, say nothing; and beyond these limits it is not the noise that is wrong
_LEAST_SEEN = 200
_LIMITS = (0.5, 3.0)


def chi2_shares(rig: Rig, xy_img: Array, sigma_px: Array, xyz_world: Array, n_views: Array) -> Array:
    """(R,) of every point whose views all agree: chi-square of its residuals over the median that is expected.

    Args:
        xy_img: (..., C, K, 2) views of the points, NaN where they do not count. sigma_px: (..., C, K).
        xyz_world: (..., K, 3) the points, fused robustly from these views. n_views: (..., K) how many agreed.
    """
    off = (xy_img - np.moveaxis(rig.project(xyz_world), 0, -3)) / sigma_px[..., None]
    used: Array = np.asarray(np.isfinite(off).all(axis=-1))
    count = used.sum(axis=-2)
    # coordinates that were seen less those of the point
    freedom = 2 * count - 3
    known = (freedom > 0) & (count == n_views)
    chi2 = (np.where(used[..., None], off, 0.0) ** 2).sum(axis=(-3, -1))[known]
    return np.asarray(chi2 / (2 * gammaincinv(freedom[known] / 2, 0.5)))


def noise_scale(shares: Array) -> float | None:
    """By what the stated standard deviations are to be multiplied, from 0.5 to 3; None where too little is seen."""
    return float(np.clip(np.sqrt(np.median(shares)), *_LIMITS)) if len(shares) >= _LEAST_SEEN else None
