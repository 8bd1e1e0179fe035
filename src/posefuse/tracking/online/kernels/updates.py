"""Views into the motion models: one ray into a keypoint, all rays of a view into the body as a whole."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel
from posefuse.tracking.smooth_kernels import add_product, inverse3

from .rays import depth_row, expected, ray, squared
from .state import combined, normalise

_FOUND_M, _FOUND_M_S = 0.03, 2.0  # of a place where rays meet, and of the motion there


@kernel()
def update(x, cov, share, rows, away, common, new_share, rules):
    """One ray into all models of a keypoint; `away` (M, 2) its error from each, `common` (3, 3) what the body adds to it.

    A depth is one row, the other one zero. Whether the ray is an outlier is judged by its stated variance; what counts is the
    share `new_share` of it.
    Returns its squared distance from the model that expected it most; nothing is changed beyond the gate.
    """
    m = len(share)
    nearest = np.inf
    for j in range(m):
        s00, s01, s11 = expected(rows, cov[j, :3, :3] + common, 1.0)
        nearest = min(nearest, squared(s00, s01, s11, away[j, 0], away[j, 1]))
    if not nearest <= rules.gate_chi2:
        return nearest
    # beyond the knee a view is believed as if it were as noisy as it turned out to be
    noise = new_share + max(nearest / rules.outlier_chi2, 1.0) - 1.0
    best = np.inf
    for j in range(m):
        s00, s01, s11 = expected(rows, cov[j, :3, :3] + common, noise)
        best = min(best, squared(s00, s01, s11, away[j, 0], away[j, 1]))
    gain = np.empty((9, 2))
    for j in range(m):
        s00, s01, s11 = expected(rows, cov[j, :3, :3] + common, noise)
        det = s00 * s11 - s01 * s01
        e0, e1 = away[j, 0], away[j, 1]
        share[j] *= math.exp(0.5 * (best - squared(s00, s01, s11, e0, e1))) / math.sqrt(det)
        for i in range(9):
            t0, t1 = 0.0, 0.0
            for a in range(3):
                t0 += cov[j, i, a] * rows[0, a]
                t1 += cov[j, i, a] * rows[1, a]
            gain[i, 0] = (t0 * s11 - t1 * s01) / det
            gain[i, 1] = (t1 * s00 - t0 * s01) / det
            x[j, i] += gain[i, 0] * e0 + gain[i, 1] * e1
        for i in range(9):
            g0 = gain[i, 0] * s00 + gain[i, 1] * s01
            g1 = gain[i, 0] * s01 + gain[i, 1] * s11
            for a in range(i, 9):
                cov[j, i, a] -= g0 * gain[a, 0] + g1 * gain[a, 1]
                cov[j, a, i] = cov[j, i, a]
    normalise(share)
    return nearest


@kernel()
def begin_again(person, xyz):
    """Put keypoints of a person at world places xyz (K, 3), unsure how fast; NaN leaves one as it is.

    Their places are so sure that the views that were wrong before do not count again.
    """
    x, cov, share = person.x, person.cov, person.share
    k, m = len(xyz), x.shape[1]
    body = np.zeros(3)
    for j in range(m):
        for a in range(3):
            body[a] += share[k, j] * x[k, j, a]
    for i in range(k):
        if not math.isfinite(xyz[i, 0]):
            continue
        for j in range(m):
            share[i, j] = 1.0 / m
            x[i, j, :] = 0.0
            cov[i, j, :, :] = 0.0
            for a in range(3):
                x[i, j, a] = xyz[i, a] - body[a]
                cov[i, j, a, a] = _FOUND_M**2
                cov[i, j, 3 + a, 3 + a] = _FOUND_M_S**2


@kernel()
def move_body(view, source, person, means, spreads, session, deep=None):
    """All keypoints of one view together as a measurement of the body's position: one measurement of its three coordinates.

    Its information and pull are sums over the keypoints, each with the uncertainty of its position relative to the body.
    Keypoint i of the person is `source[i]` of the view. Returns how many depths (K, 2) are among them.
    """
    z, white, late = view.z, view.white, view.late_s
    x, cov, share = person.x, person.cov, person.share
    camera, rules = session.cameras[view.camera], session.rules
    depths = 0
    k, m = len(z), x.shape[1]
    info, pull = np.zeros((3, 3)), np.zeros(3)
    rows, error, point = np.empty((2, 3)), np.empty(2), np.empty(3)
    for i in range(k):
        o = source[i]
        if not (math.isfinite(z[o, 0]) and math.isfinite(means[i, 0])):
            continue
        for a in range(3):
            drift = 0.0
            for j in range(m):
                drift += share[k, j] * x[k, j, 3 + a] + share[i, j] * x[i, j, 3 + a]
            point[a] = means[k, a] + means[i, a] + late[o] * drift
        if not ray(camera, point, white[o], z[o], rows, error):
            continue
        if not _gathered(rows, error, spreads[i], spreads[k], rules.new_share, rules, info, pull):
            continue
        if deep is not None and deep[o, 1] > 0.0:
            error[0], error[1] = depth_row(camera, point, deep[o], rows[0]), 0.0
            rows[1] = 0.0
            depths += _gathered(rows, error, spreads[i], spreads[k], 1.0, rules, info, pull)
    _pull(x[k], cov[k], share[k], means[k], info, pull)
    combined(x[k], cov[k], share[k], means[k], spreads[k])
    return depths


@kernel()
def _gathered(rows, error, own, common, new_share, rules, info, pull):
    """Add two rows to information (3, 3) and pull (3,), uncertain by what is `own` of the keypoint; whether they count."""
    s00, s01, s11 = expected(rows, own + common, 1.0)
    far = squared(s00, s01, s11, error[0], error[1])
    if not far <= rules.gate_chi2:
        return False
    s00, s01, s11 = expected(rows, own, new_share + max(far / rules.outlier_chi2, 1.0) - 1.0)
    det = s00 * s11 - s01 * s01
    for a in range(3):
        g0 = (rows[0, a] * s11 - rows[1, a] * s01) / det
        g1 = (rows[1, a] * s00 - rows[0, a] * s01) / det
        pull[a] += g0 * error[0] + g1 * error[1]
        for d in range(3):
            info[a, d] += g0 * rows[0, d] + g1 * rows[1, d]
    return True


@kernel()
def _pull(x, cov, share, about, info, pull):
    """A measurement of position by its information (3, 3), and pull (3,) at `about`, into all models of one point."""
    m = len(share)
    mix, inverse, gain, u = np.empty((3, 3)), np.empty((3, 3)), np.empty((9, 3)), np.empty(3)
    likely = np.empty(m)
    for j in range(m):
        for a in range(3):
            u[a] = pull[a]
            for d in range(3):
                u[a] -= info[a, d] * (x[j, d] - about[d])
        mix[:], gain[:] = np.eye(3), 0.0
        add_product(mix, 1.0, info, cov[j, :3, :3])
        det = inverse3(mix, inverse)
        add_product(gain, 1.0, cov[j, :, :3], inverse)
        value = -0.5 * math.log(det)
        for a in range(3):
            away = x[j, a] - about[a]
            value += pull[a] * away
            for d in range(3):
                value += 0.5 * u[a] * gain[a, d] * u[d] - 0.5 * away * info[a, d] * (x[j, d] - about[d])
        likely[j] = value
        top = cov[j, :3].copy()
        for i in range(9):
            for a in range(3):
                x[j, i] += gain[i, a] * u[a]
        for i in range(9):
            for d in range(9):
                for a in range(3):
                    for e in range(3):
                        cov[j, i, d] -= gain[i, a] * info[a, e] * top[e, d]
        for i in range(9):
            for d in range(i):
                cov[j, i, d] = cov[j, d, i] = 0.5 * (cov[j, i, d] + cov[j, d, i])
    best = likely.max()
    for j in range(m):
        share[j] *= math.exp(likely[j] - best)
    normalise(share)
