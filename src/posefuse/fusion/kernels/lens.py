"""Lenses of the views of a time step, by the arithmetic of `core.lens`, compiled: many small calls a second."""

import math

from numba import njit

from posefuse.core.lens import ACCEPTED_NORM, CONVERGED_NORM, ITERATIONS, brown
from posefuse.foundation.compiled import kernel

_brown = njit(error_model="numpy")(brown)


@kernel()
def apply_lenses(coefficients, xy):
    """Ideal points xy (G, C, K, 2) become what lenses (C, 14) make of them, in place. As `core.lens.distort`."""
    for g in range(xy.shape[0]):
        for c in range(xy.shape[1]):
            for i in range(xy.shape[2]):
                xy[g, c, i, 0], xy[g, c, i, 1] = _brown(xy[g, c, i, 0], xy[g, c, i, 1], coefficients[c])[:2]


@kernel()
def remove_lenses(coefficients, xy, by_ideal):
    """Points xy (G, C, K, 2) before the intrinsic matrix become ideal, in place; NaN where the lens (C, 14) has no inverse.

    Fills by_ideal (G, C, K, 2, 2), the derivatives of the points that were given. As `core.lens.undistort` and `slopes`.
    """
    for g in range(xy.shape[0]):
        for c in range(xy.shape[1]):
            for i in range(xy.shape[2]):
                _remove_lens(coefficients[c], xy[g, c, i], by_ideal[g, c, i])


@kernel()
def _remove_lens(k, xy, by_ideal):
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
    by_ideal[0, 0], by_ideal[0, 1], by_ideal[1, 0], by_ideal[1, 1] = a, b, c, d
