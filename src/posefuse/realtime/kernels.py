"""Compiled parts of the fusion loop, on plain arrays."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel
from posefuse.tracking.online.kernels.rays import expected, ray

# columns of a camera: rotation (9), translation (3), as `rays` reads them; then fx, fy, cx, cy, width, height
CAMERA_SIZE = 18
_EDGE_PX = 4.0


@kernel()
def gain(cameras, sigma_px, xyz, cov, out):
    """out (C,) nats of information one frame of each camera adds about xyz (N, K, 3) with cov (N, K, 3, 3); see `scheduling`."""
    h, rows = np.empty(2), np.empty((2, 3))
    for c in range(len(cameras)):
        camera, total = cameras[c], 0.0
        for n in range(xyz.shape[0]):
            for k in range(xyz.shape[1]):
                total += _keypoint_gain(camera, sigma_px[c], xyz[n, k], cov[n, k], h, rows)
        out[c] = total


@kernel()
def _keypoint_gain(camera, sigma_px, point, cov, h, rows):
    if not ray(camera, point, h, rows):
        return 0.0
    u, v = camera[12] * h[0] + camera[14], camera[13] * h[1] + camera[15]
    inside = _EDGE_PX < u < camera[16] - _EDGE_PX and _EDGE_PX < v < camera[17] - _EDGE_PX
    if not inside:
        return 0.0
    for a in range(3):
        rows[0, a] *= camera[12] / sigma_px
        rows[1, a] *= camera[13] / sigma_px
    s00, s01, s11 = expected(rows, cov, 1.0)
    determinant = s00 * s11 - s01 * s01
    # a covariance that is not known is NaN
    return 0.5 * math.log(determinant) if determinant > 1.0 else 0.0
