"""What is known of a person at a time that is asked for."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array
from posefuse.foundation.compiled import kernel
from posefuse.tracking.smooth_kernels import inverse3

from .body import hold_bones
from .state import all_models, combined, position

_OUT_OF_SIGHT_M = 0.5  # along a ray no other person crosses


class PoseRow(NamedTuple):
    """One person of a pose: positions (K, 3), covariances (K, 3, 3), rms px (K,), views (K,), kind (K,)."""

    xyz: Array
    cov: Array
    reproj: Array
    n_views: Array
    kind: Array


@kernel()
def where(person, t, session, means, sigmas):
    """Positions (K, 3) expected at time t and how sure (K,), standard deviation; NaN where not tracked."""
    x, cov, share = person.x, person.cov, person.share
    k = len(x) - 1
    spread = np.empty((3, 3))
    f, q = all_models(t - person.time[0], session.models)
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
def pose(person, t, session, kinds, out):
    """What comes out at time t, filled into out; kinds: FUSED and PREDICTED."""
    rules = session.rules
    k = len(person.x) - 1
    dt = t - person.time[0]
    f, q = all_models(dt, session.models)
    body, common = np.empty(3), np.empty((3, 3))
    position(person.x[k], person.cov[k], person.share[k], f[1], q[1], body, common)
    place, body_known, known = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    combined(person.x[k], person.cov[k], person.share[k], place, body_known)
    for i in range(k):
        out.xyz[i], out.cov[i], out.reproj[i], out.n_views[i], out.kind[i] = np.nan, np.nan, np.nan, 0, 0
        newest = person.seen[i].max()
        if not math.isfinite(person.x[i, 0, 0]) or t - max(newest, 0.0) > rules.lost_after_s:
            continue
        position(person.x[i], person.cov[i], person.share[i], f[0], q[0], out.xyz[i], out.cov[i])
        out.xyz[i] += body
        out.cov[i] += common
        combined(person.x[i], person.cov[i], person.share[i], place, known)
        _add_lasting(person, i, known + body_known, out.xyz[i], session, out.cov[i])
        total = 0.0
        for c in range(len(session.cameras)):
            if t - person.seen[i, c] <= rules.measured_s:
                out.n_views[i] += 1
                total += person.square[i, c]
        out.kind[i] = kinds[0] if out.n_views[i] > 0 else kinds[1]
        if out.n_views[i] > 0:
            out.reproj[i] = math.sqrt(total / out.n_views[i])
    hold_bones(out.xyz, out.cov, person.bones, session.ends, rules.bone_sigma_m)
    # since the newest view an acceleration may have begun, as strong as there were lately
    unseen = (0.5 * max(dt, 0.0) ** 2) ** 2
    for i in range(k):
        for a in range(3):
            out.cov[i, a, a] += unseen * (person.lively[i] + person.lively[k])


@kernel()
def _add_lasting(person, i, known, mean, session, spread):
    """spread += the effect of temporally correlated errors of the views that measured keypoint i, at mean (3,), last.

    It is what these views of one moment would give, less what the filter averages: the longer it looks back, the smaller its
    own covariance `known` after the newest view, and the less is left.
    """
    cameras, rules = session.cameras, session.rules
    seen, precision, deepness = person.seen[i], person.precision[i], person.deepness[i]
    oldest = seen.max() - rules.measured_s
    information, inverse = np.zeros((3, 3)), np.empty((3, 3))
    inverse3(known, inverse)
    for a in range(3):
        information[a, a] = 1.0 / _OUT_OF_SIGHT_M**2
        for d in range(3):
            information[a, d] += rules.averaging * inverse[a, d]
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
                information[a, d] += w * across + deepness[c] * cameras[c, 8 + a] * cameras[c, 8 + d]
    inverse3(information, inverse)
    for a in range(3):
        for d in range(3):
            spread[a, d] += rules.lasting_share * inverse[a, d]
