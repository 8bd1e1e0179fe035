"""What the kernels read of a session and of a view, what is known of one person, and how that moves on in time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array
from posefuse.foundation.compiled import kernel


class Rules(NamedTuple):
    """What the kernels read of `LiveMotion` and `LiveSettings`, by its names there."""

    outlier_chi2: float
    gate_chi2: float
    switch_s: float
    lost_after_s: float
    new_share: float
    alone_hold_s: float
    measured_s: float
    lasting_share: float
    averaging: float
    bone_sigma_m: float


class SessionArrays(NamedTuple):
    """What is the same for all people and views: K keypoints, M motion models, C cameras, B bones.

    cameras: (C, 15) of `core.rig.packed_rig`. mirror: (K,) counterparts. group: (K,) the limbs a keypoint is swapped with,
    -1 on the midline. ends: (B, 2) bones. models: (2, M, 2) acceleration of keypoints and of the body, and how long it lasts.
    """

    cameras: Array
    mirror: Array
    group: Array
    ends: Array
    models: Array
    rules: Rules


class KeypointRays(NamedTuple):
    """One person in one view; or several, with an axis P before K.

    camera: its number. z: (K, 2) ideal points, NaN where unseen. white: (K, 2, 2) turns their errors into sigmas.
    late_s: (K,) how long after mid-exposure a row was exposed. sigma_px: (K,) pixels per sigma.
    """

    camera: int
    z: Array
    white: Array
    late_s: Array
    sigma_px: Array


GROUPS = 3  # arms, legs, head: what is swapped together
NEVER = -1e9
_BODY_BORN_M = 0.05  # the newborn body's middle


class TrackState(NamedTuple):
    """What is known of one person: K keypoints, M motion models, C cameras, B bones.

    x (K + 1, M, 9), cov (K + 1, M, 9, 9) and share (K + 1, M) of each model: the body as a whole in the last row, the keypoints
    against it in the others. lively (K + 1,): variance of their accelerations lately. Per camera (K, C): seen, when it last
    measured, s; square, the squared px residual; precision, 1/variance; deepness, 1/variance of its depth (0 where it has none).
    swaps (GROUPS,): share of swapped views. bones (B, 2): mean length, views. time (1,).
    """

    x: Array
    cov: Array
    share: Array
    lively: Array
    seen: Array
    square: Array
    precision: Array
    deepness: Array
    swaps: Array
    bones: Array
    time: Array

    def copy(self) -> TrackState:
        """The same in arrays of its own."""
        return TrackState(*(plane.copy() for plane in self))


def unborn(session: SessionArrays) -> TrackState:
    """A state at time 0 of which nothing is known."""
    k, m, c = len(session.mirror), session.models.shape[1], len(session.cameras)
    square, precision, deepness = np.zeros((3, k, c))
    return TrackState(
        x=np.zeros((k + 1, m, 9)),
        cov=np.zeros((k + 1, m, 9, 9)),
        share=np.zeros((k + 1, m)),
        lively=np.zeros(k + 1),
        seen=np.full((k, c), NEVER),
        square=square,
        precision=precision,
        deepness=deepness,
        swaps=np.zeros(GROUPS),
        bones=np.zeros((len(session.ends), 2)),
        time=np.zeros(1),
    )


@kernel()
def born(person, session, xyz, xyz_cov, velocity_m_s):
    """Fill an `unborn` state: positions (K, 3) with covariance (K, 3, 3), NaN where not known yet."""
    x, cov, share = person.x, person.cov, person.share
    k, m = len(x) - 1, x.shape[1]
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


# of the changes of a keypoint's model, the share that goes to the more agile one
_AGILER = 0.5
_LIVELY_S = 2.0  # over which a person's motion predicts the next changes of motion


@kernel()
def all_models(dt, models):
    """f, q (2, M, 3, 3) of `_singer`: of keypoints, and of the body."""
    m = models.shape[1]
    f, q = np.empty((2, m, 3, 3)), np.empty((2, m, 3, 3))
    for whose in range(2):
        for j in range(m):
            _singer(max(dt, 0.0), models[whose, j, 0], models[whose, j, 1], f[whose, j], q[whose, j])
    return f, q


@kernel()
def _singer(dt, sigma, lasts, f, q):
    """Transition (3, 3) and process noise (3, 3) of one axis."""
    a = 1.0 / lasts
    u = a * dt
    e, e2 = math.exp(-u), math.exp(-2.0 * u)
    f[:] = 0.0
    f[0, 0] = f[1, 1] = 1.0
    f[0, 1] = dt
    f[2, 2] = e
    f[0, 2], f[1, 2] = (u - 1.0 + e) / (a * a), (1.0 - e) / a
    v = sigma * sigma
    # over short times the terms cancel: what is left of rounding is 1e-14 of the variances, far below any noise
    q[0, 0] = v / a**4 * (1.0 - e2 + 2.0 * u + 2.0 * u**3 / 3.0 - 2.0 * u * u - 4.0 * u * e)
    q[0, 1] = v / a**3 * (e2 + 1.0 - 2.0 * e + 2.0 * u * e - 2.0 * u + u * u)
    q[0, 2] = v / (a * a) * (1.0 - e2 - 2.0 * u * e)
    q[1, 1] = v / (a * a) * (4.0 * e - 3.0 - e2 + 2.0 * u)
    q[1, 2] = v / a * (e2 + 1.0 - 2.0 * e)
    q[2, 2] = v * (1.0 - e2)
    q[1, 0], q[2, 0], q[2, 1] = q[0, 1], q[0, 2], q[1, 2]


@kernel()
def _goes(i, j, m, stay):
    """Chance to change from model i to j: only to the next calmer or more agile one."""
    up = (1.0 - stay) * _AGILER if i < m - 1 else 0.0
    down = (1.0 - stay) * (1.0 - _AGILER) if i > 0 else 0.0
    if j == i + 1:
        return up
    if j == i - 1:
        return down
    return 1.0 - up - down if i == j else 0.0


@kernel()
def mix(x, cov, share, stay, mixed_x, mixed_cov, mixed_share):
    """What each model of one keypoint starts the next step from, and its share, when a model is kept with chance `stay`."""
    m = len(share)
    for j in range(m):
        total = 0.0
        for i in range(m):
            total += _goes(i, j, m, stay) * share[i]
        mixed_share[j] = total
        mixed_x[j, :] = 0.0
        mixed_cov[j, :, :] = 0.0
        for i in range(m):
            w = _goes(i, j, m, stay) * share[i] / total
            for a in range(9):
                mixed_x[j, a] += w * x[i, a]
        for i in range(m):
            w = _goes(i, j, m, stay) * share[i] / total
            if w < 1e-9:
                continue
            for a in range(9):
                da = x[i, a] - mixed_x[j, a]
                for d in range(a, 9):
                    mixed_cov[j, a, d] += w * (cov[i, a, d] + da * (x[i, d] - mixed_x[j, d]))
        for a in range(9):
            for d in range(a):
                mixed_cov[j, a, d] = mixed_cov[j, d, a]


@kernel()
def predict_model(x, cov, f, q):
    """One model's x (9,) and cov (9, 9) through f, q (3, 3) of every axis, in place."""
    f01, f02, f12, f22 = f[0, 1], f[0, 2], f[1, 2], f[2, 2]
    for a in range(3):
        x[a] += f01 * x[3 + a] + f02 * x[6 + a]
        x[3 + a] += f12 * x[6 + a]
        x[6 + a] *= f22
    for a in range(3):
        for d in range(9):
            cov[a, d] += f01 * cov[3 + a, d] + f02 * cov[6 + a, d]
            cov[3 + a, d] += f12 * cov[6 + a, d]
            cov[6 + a, d] *= f22
    for d in range(9):
        for a in range(3):
            cov[d, a] += f01 * cov[d, 3 + a] + f02 * cov[d, 6 + a]
            cov[d, 3 + a] += f12 * cov[d, 6 + a]
            cov[d, 6 + a] *= f22
    for a in range(3):
        for i in range(3):
            for j in range(3):
                cov[3 * i + a, 3 * j + a] += q[i, j]


@kernel()
def position(x, cov, share, f, q, mean, spread):
    """Position (3,) and covariance (3, 3) of one keypoint carried on by f, q."""
    m = len(share)
    p, s = np.empty((m, 3)), np.empty((m, 3, 3))
    for j in range(m):
        for a in range(3):
            p[j, a] = x[j, a] + f[j, 0, 1] * x[j, 3 + a] + f[j, 0, 2] * x[j, 6 + a]
            for d in range(3):
                total = 0.0
                for u in range(3):
                    for v in range(3):
                        total += f[j, 0, u] * cov[j, 3 * u + a, 3 * v + d] * f[j, 0, v]
                s[j, a, d] = total + (q[j, 0, 0] if a == d else 0.0)
    combined(p, s, share, mean, spread)


@kernel()
def combined(x, cov, share, mean, spread):
    """Position (3,) and covariance (3, 3) of one keypoint over its models x (M, 3 or more), cov."""
    m = len(share)
    for a in range(3):
        mean[a] = 0.0
        for j in range(m):
            mean[a] += share[j] * x[j, a]
    spread[:] = 0.0
    for j in range(m):
        for a in range(3):
            for d in range(3):
                spread[a, d] += share[j] * (cov[j, a, d] + (x[j, a] - mean[a]) * (x[j, d] - mean[d]))


@kernel()
def normalise(share):
    """Shares that sum to 1; none dies out, so that the next change finds it alive."""
    total = share.sum()
    for j in range(len(share)):
        share[j] = max(share[j] / total, 1e-4)
    share /= share.sum()


@kernel()
def learn_liveliness(lively, share, models, dt):
    """How strongly the body, and each keypoint against it, accelerates over some seconds: calm for now is not calm for good."""
    memory = 1.0 - math.exp(-dt / _LIVELY_S)
    for i in range(len(lively)):
        now = 0.0
        for j in range(share.shape[1]):
            now += share[i, j] * models[1 if i == len(lively) - 1 else 0, j, 0] ** 2
        lively[i] += memory * (now - lively[i])
