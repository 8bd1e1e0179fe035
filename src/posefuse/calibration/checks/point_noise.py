"""How far noise in the images moves a point that several cameras triangulate."""

from __future__ import annotations

import numpy as np

from posefuse.core import Rig
from posefuse.core.arrays import Array

# the error of a slope grows with its square and is negligible at this size
_STEP_M = 1e-4


def point_covariance(rig: Rig, xyz_world: Array, xy_img: Array, noise_px: float) -> Array:
    """(P, 3, 3) m^2 of points (P, 3) seen at (C, P, 2) px, NaN where unseen, with noise of `noise_px` on each coordinate.

    By the inverse of the normal equations of least squares (Gauss-Markov); slopes by central differences.
    """
    seen = np.all(np.isfinite(xy_img), axis=-1)
    slope = np.empty((*xy_img.shape, 3))
    for axis in range(3):
        step = _STEP_M * np.eye(3)[axis]
        slope[..., axis] = (rig.project(xyz_world + step) - rig.project(xyz_world - step)) / (2 * _STEP_M)
    slope = np.where(seen[..., None, None], slope, 0.0)
    normal = np.einsum("cpki,cpkj->pij", slope, slope)
    known = np.isfinite(normal).all(axis=(1, 2))
    out = np.full(normal.shape, np.nan)
    # a point that two cameras see along one line has no depth: some variance rather than an error
    out[known] = noise_px**2 * np.linalg.pinv(normal[known], hermitian=True)
    return out
