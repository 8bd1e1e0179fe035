"""What is known of one person, as one flat float64 array, so that keeping one per view is one copy."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

GROUPS = 3  # arms, legs, head: what is exchanged together
NEVER = -1e9
_BODY_BORN_M = 0.05  # the newborn body's middle


@kernel()
def state_size(k, m, c, b):
    """Length of a state of k keypoints, m models, c cameras, b bones."""
    return (k + 1) * (m * 91 + 1) + 4 * k * c + k + GROUPS + 2 * b + 1


@kernel()
def parts(state, k, m, c, b):
    """Views into a state.

    x (K + 1, M, 9), its covariance (K + 1, M, 9, 9), the share (K + 1, M) of each model: the body as a whole in the last row,
    the keypoints against it in the others; variance (K + 1,) of their accelerations lately; per camera (K, C): when it last
    measured, the squared px residual, 1/variance, 1/variance of its depth (0 where it has none); views refused in a row (K,);
    share of exchanged views (GROUPS,); bones (B, 2): mean length, views; the time (1,).
    """
    rows = k + 1
    at = rows * m * 9
    x = state[:at].reshape(rows, m, 9)
    cov = state[at : at + rows * m * 81].reshape(rows, m, 9, 9)
    at += rows * m * 81
    share = state[at : at + rows * m].reshape(rows, m)
    at += rows * m
    lively = state[at : at + rows]
    at += rows
    seen = state[at : at + k * c].reshape(k, c)
    at += k * c
    square = state[at : at + k * c].reshape(k, c)
    at += k * c
    precision = state[at : at + k * c].reshape(k, c)
    at += k * c
    deepness = state[at : at + k * c].reshape(k, c)
    at += k * c
    refused = state[at : at + k]
    at += k
    flips = state[at : at + GROUPS]
    at += GROUPS
    bones = state[at : at + 2 * b].reshape(b, 2)
    return x, cov, share, lively, seen, square, precision, deepness, refused, flips, bones, state[at + 2 * b :]


@kernel()
def born(state, k, m, c, b, xyz, xyz_cov, velocity_m_s, models):
    """Fill a state at time 0: positions (K, 3) with covariance (K, 3, 3), NaN where not known yet."""
    x, cov, share, _, seen, _, _, _, _, _, _, time = parts(state, k, m, c, b)
    state[:] = 0.0
    seen[:] = NEVER
    time[0] = 0.0
    middle, count = np.zeros(3), 0
    for i in range(k):
        if math.isfinite(xyz[i, 0]) and math.isfinite(xyz_cov[i, 0, 0]):
            middle += xyz[i]
            count += 1
    middle /= max(count, 1)
    for i in range(k + 1):
        known = i == k or (math.isfinite(xyz[i, 0]) and math.isfinite(xyz_cov[i, 0, 0]))
        for j in range(m):
            share[i, j] = 1.0 / m
            for a in range(3):
                if i == k:
                    x[i, j, a] = middle[a]
                    cov[i, j, a, a] = _BODY_BORN_M**2
                else:
                    x[i, j, a] = xyz[i, a] - middle[a] if known else np.nan
                    for d in range(3):
                        cov[i, j, a, d] = xyz_cov[i, a, d] if known else 0.0
                cov[i, j, 3 + a, 3 + a] = velocity_m_s * velocity_m_s
                cov[i, j, 6 + a, 6 + a] = models[1 if i == k else 0, j, 0] ** 2
