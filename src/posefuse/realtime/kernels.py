"""Compiled parts of the fusion loop, on plain arrays."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

# columns of a camera: rotation (9), translation (3), fx, fy, cx, cy, width, height
CAMERA_SIZE = 18
_NEAREST_M = 0.1
_EDGE_PX = 4.0


@kernel()
def gain(cameras, sigma_px, xyz, cov, out):
    """out (C,) nats that one frame of each camera tells about keypoints xyz (N, K, 3) with cov (N, K, 3, 3); see `scheduling`."""
    rows = np.empty((2, 3))
    for c in range(len(cameras)):
        camera, total = cameras[c], 0.0
        for n in range(xyz.shape[0]):
            for k in range(xyz.shape[1]):
                total += _keypoint_gain(camera, sigma_px[c], xyz[n, k], cov[n, k], rows)
        out[c] = total


@kernel()
def _keypoint_gain(camera, sigma_px, point, cov, rows):
    X = camera[0] * point[0] + camera[1] * point[1] + camera[2] * point[2] + camera[9]
    Y = camera[3] * point[0] + camera[4] * point[1] + camera[5] * point[2] + camera[10]
    Z = camera[6] * point[0] + camera[7] * point[1] + camera[8] * point[2] + camera[11]
    # also where a coordinate is NaN
    if not Z > _NEAREST_M:
        return 0.0
    x, y = X / Z, Y / Z
    u, v = camera[12] * x + camera[14], camera[13] * y + camera[15]
    inside = _EDGE_PX < u < camera[16] - _EDGE_PX and _EDGE_PX < v < camera[17] - _EDGE_PX
    if not inside:
        return 0.0
    for a in range(3):
        rows[0, a] = camera[12] / sigma_px * (camera[a] - x * camera[6 + a]) / Z
        rows[1, a] = camera[13] / sigma_px * (camera[3 + a] - y * camera[6 + a]) / Z
    s00, s01, s11 = 1.0, 0.0, 1.0
    for a in range(3):
        t0, t1 = 0.0, 0.0
        for d in range(3):
            t0 += cov[a, d] * rows[0, d]
            t1 += cov[a, d] * rows[1, d]
        s00 += rows[0, a] * t0
        s01 += rows[0, a] * t1
        s11 += rows[1, a] * t1
    determinant = s00 * s11 - s01 * s01
    # a covariance that is not known is NaN
    return 0.5 * math.log(determinant) if determinant > 1.0 else 0.0
