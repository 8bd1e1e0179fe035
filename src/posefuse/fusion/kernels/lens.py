"""Lenses of the views of a time step, by the arithmetic of `core.lens`, compiled: many small calls a second."""

import math

from numba import njit

from posefuse.core.lens import ACCEPTED_NORM, CONVERGED_NORM, ITERATIONS, brown
from posefuse.foundation.compiled import kernel

from .cameras import R00, R01, R02, R10, R11, R12, R20, R21, R22, TX, TY, TZ

_brown = njit(error_model="numpy")(brown)


@kernel()
def project(cams, focal, centre, coefficients, xyz, px):
    """World points xyz (G, K, 3) in raw px (G, C, K, 2), filled in; NaN behind the camera. As `core.camera.Camera.project`.

    Of cameras (C, 15): focal part of the intrinsic matrices (C, 2, 2), principal points (C, 2), lenses (C, 14).
    """
    for g in range(xyz.shape[0]):
        for c in range(len(cams)):
            for i in range(xyz.shape[1]):
                x, y, z = xyz[g, i]
                depth = cams[c, R20] * x + cams[c, R21] * y + cams[c, R22] * z + cams[c, TZ]
                depth = depth if depth > 0 else math.nan
                ideal_x = (cams[c, R00] * x + cams[c, R01] * y + cams[c, R02] * z + cams[c, TX]) / depth
                ideal_y = (cams[c, R10] * x + cams[c, R11] * y + cams[c, R12] * z + cams[c, TY]) / depth
                u, v = _brown(ideal_x, ideal_y, coefficients[c])[:2]
                for a in range(2):
                    px[g, c, i, a] = focal[c, a, 0] * u + focal[c, a, 1] * v + centre[c, a]


@kernel()
def remove_lenses(focal, coefficients, xy, px_by_ideal):
    """Points xy (G, C, K, 2) before the intrinsic matrix become ideal, in place; NaN where the lens (C, 14) has no inverse.

    Fills px_by_ideal (G, C, K, 2, 2), the derivatives of raw px. As `core.lens.undistort` and `slopes`.
    """
    for g in range(xy.shape[0]):
        for c in range(xy.shape[1]):
            for i in range(xy.shape[2]):
                _remove_lens(focal[c], coefficients[c], xy[g, c, i], px_by_ideal[g, c, i])


@kernel()
def _remove_lens(focal, k, xy, px_by_ideal):
    bent_x, bent_y = xy
    x, y = bent_x, bent_y
    for _ in range(ITERATIONS):
        u, v, a, b, c, d = _brown(x, y, k)
        det = a * d - b * c
        # past the fold of the model the determinant changes sign: there is no inverse beyond it
        det = det if det > 0 else math.nan
        step_x, step_y = (d * (u - bent_x) - b * (v - bent_y)) / det, (a * (v - bent_y) - c * (u - bent_x)) / det
        x, y = x - step_x, y - step_y
        if not (abs(step_x) > CONVERGED_NORM or abs(step_y) > CONVERGED_NORM):
            break
    u, v, a, b, c, d = _brown(x, y, k)
    good = abs(u - bent_x) < ACCEPTED_NORM and abs(v - bent_y) < ACCEPTED_NORM
    xy[0], xy[1] = (x, y) if good else (math.nan, math.nan)
    for i in range(2):
        px_by_ideal[i, 0], px_by_ideal[i, 1] = focal[i, 0] * a + focal[i, 1] * c, focal[i, 0] * b + focal[i, 1] * d
