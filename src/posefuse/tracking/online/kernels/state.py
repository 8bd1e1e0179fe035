"""What is known of one person, as one flat float64 array, so that keeping one per view is one copy."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array
from posefuse.foundation.compiled import kernel

GROUPS = 3  # arms, legs, head: what is exchanged together
NEVER = -1e9
_BODY_BORN_M = 0.05  # the newborn body's middle


class StateParts(NamedTuple):
    """Views into a state: K keypoints, M motion models, C cameras, B bones.

    x (K + 1, M, 9), cov (K + 1, M, 9, 9) and share (K + 1, M) of each model: the body as a whole in the last row, the keypoints
    against it in the others. lively (K + 1,): variance of their accelerations lately. Per camera (K, C): seen, when it last
    measured, s; square, the squared px residual; precision, 1/variance; deepness, 1/variance of its depth (0 where it has none).
    refused (K,): views refused in a row. flips (GROUPS,): share of exchanged views. bones (B, 2): mean length, views. time (1,).
    """

    x: Array
    cov: Array
    share: Array
    lively: Array
    seen: Array
    square: Array
    precision: Array
    deepness: Array
    refused: Array
    flips: Array
    bones: Array
    time: Array


@kernel()
def sizes(session):
    """Keypoints, motion models, cameras, bones."""
    return len(session.mirror), session.models.shape[1], len(session.cameras), len(session.ends)


@kernel()
def state_size(session):
    """Length of a state."""
    k, m, c, b = sizes(session)
    return (k + 1) * (m * 91 + 1) + 4 * k * c + k + GROUPS + 2 * b + 1


@kernel()
def parts(state, session):
    """See `StateParts`."""
    k, m, c, b = sizes(session)
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
    time = state[at + 2 * b :]
    return StateParts(x, cov, share, lively, seen, square, precision, deepness, refused, flips, bones, time)


@kernel()
def born(state, session, xyz, xyz_cov, velocity_m_s):
    """Fill a state at time 0: positions (K, 3) with covariance (K, 3, 3), NaN where not known yet."""
    person = parts(state, session)
    x, cov, share = person.x, person.cov, person.share
    k, m = len(x) - 1, x.shape[1]
    state[:] = 0.0
    person.seen[:] = NEVER
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
                cov[i, j, 6 + a, 6 + a] = session.models[1 if i == k else 0, j, 0] ** 2
