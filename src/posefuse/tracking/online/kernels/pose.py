"""What is known of a person at a time that is asked for."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel
from posefuse.tracking.matrix_kernels import inverse3

from .body import hold_bones
from .motion import all_models, combined, position
from .state import parts

_OUT_OF_SIGHT_M = 0.5  # along a ray no other person crosses


@kernel()
def where(state, t, sizes, models, means, sigmas):
    """Positions (K, 3) expected at time t and how sure (K,), standard deviation; NaN where not tracked."""
    k, m, c, b = sizes
    spread = np.empty((3, 3))
    x, cov, share, _, _, _, _, _, _, _, _, time = parts(state, k, m, c, b)
    f, q = all_models(t - time[0], models)
    body, common = np.empty(3), np.empty((3, 3))
    position(x[k], cov[k], share[k], f[1], q[1], body, common)
    for i in range(k):
        means[i], sigmas[i] = np.nan, np.nan
        if math.isfinite(x[i, 0, 0]):
            position(x[i], cov[i], share[i], f[0], q[0], means[i], spread)
            means[i] += body
            spread += common
            sigmas[i] = math.sqrt((spread[0, 0] + spread[1, 1] + spread[2, 2]) / 3.0)


@kernel()
def pose(state, t, cameras, ends, sizes, models, rules, xyz, cov, reproj, n_views, kind):
    """What comes out at time t: positions (K, 3), covariances (K, 3, 3), rms px (K,), views (K,), kind (K,).

    rules: measured_s, lost_after_s, lasting_share, averaging, bone_sigma_m, kinds FUSED and PREDICTED.
    """
    k, m, count, b = sizes
    x, p, share, lively, seen, square, precision, deepness, _, _, bones, time = parts(state, k, m, count, b)
    dt = t - time[0]
    f, q = all_models(dt, models)
    body, common = np.empty(3), np.empty((3, 3))
    position(x[k], p[k], share[k], f[1], q[1], body, common)
    place, body_known, known = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    combined(x[k], p[k], share[k], place, body_known)
    for i in range(k):
        xyz[i], cov[i], reproj[i], n_views[i], kind[i] = np.nan, np.nan, np.nan, 0, 0
        newest = seen[i].max()
        if not math.isfinite(x[i, 0, 0]) or t - max(newest, 0.0) > rules[1]:
            continue
        position(x[i], p[i], share[i], f[0], q[0], xyz[i], cov[i])
        xyz[i] += body
        cov[i] += common
        combined(x[i], p[i], share[i], place, known)
        _add_lasting(
            rules[2], rules[3], known + body_known, xyz[i], seen[i], precision[i], deepness[i], newest - rules[0], cameras, cov[i]
        )  # fmt: skip
        total = 0.0
        for c in range(count):
            if t - seen[i, c] <= rules[0]:
                n_views[i] += 1
                total += square[i, c]
        kind[i] = rules[5] if n_views[i] > 0 else rules[6]
        if n_views[i] > 0:
            reproj[i] = math.sqrt(total / n_views[i])
    hold_bones(xyz, cov, bones, ends, rules[4])
    # since the newest view an acceleration may have begun, as strong as there were lately
    unseen = (0.5 * max(dt, 0.0) ** 2) ** 2
    for i in range(k):
        for a in range(3):
            cov[i, a, a] += unseen * (lively[i] + lively[k])


@kernel()
def _add_lasting(share, averaging, known, mean, seen, precision, deepness, oldest, cameras, spread):
    """spread += the effect of temporally correlated errors of the views not older than `oldest`.

    It is what these views of one moment would give, less what the filter averages: the longer it looks back, the smaller its
    own covariance `known` after the newest view, and the less is left.
    """
    information, inverse = np.zeros((3, 3)), np.empty((3, 3))
    inverse3(known, inverse)
    for a in range(3):
        information[a, a] = 1.0 / _OUT_OF_SIGHT_M**2
        for d in range(3):
            information[a, d] += averaging * inverse[a, d]
    for c in range(len(seen)):
        if seen[c] < oldest:
            continue
        d2 = 0.0
        for a in range(3):
            d2 += (mean[a] - cameras[c, 12 + a]) ** 2
        w = precision[c] / d2
        for a in range(3):
            for d in range(3):
                across = (1.0 if a == d else 0.0) - (mean[a] - cameras[c, 12 + a]) * (mean[d] - cameras[c, 12 + d]) / d2
                information[a, d] += w * across + deepness[c] * cameras[c, 6 + a] * cameras[c, 6 + d]
    inverse3(information, inverse)
    for a in range(3):
        for d in range(3):
            spread[a, d] += share * inverse[a, d]
