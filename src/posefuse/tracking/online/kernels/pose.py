"""What is known of a person at a time that is asked for, and the rays of a view that is kept."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array
from posefuse.foundation.compiled import kernel
from posefuse.tracking.smooth_kernels import inverse3

from .body import hold_bones
from .state import GROUPS, all_models, combined, parts, position
from .step import sources

_OUT_OF_SIGHT_M = 0.5  # along a ray no other person crosses


@kernel()
def places(person, f, means):
    """Positions (K, 3) carried on by f (2, M, 3, 3), of keypoints and of the body; NaN where not tracked."""
    k = len(means)
    body = np.empty(3)
    _carried(person.x[k], person.share[k], f[1], body)
    for i in range(k):
        means[i] = np.nan
        if math.isfinite(person.x[i, 0, 0]):
            _carried(person.x[i], person.share[i], f[0], means[i])
            means[i] += body


@kernel()
def _carried(x, share, f, mean):
    """Position (3,) of one keypoint carried on by f, over its models."""
    mean[:] = 0.0
    for j in range(len(share)):
        for a in range(3):
            mean[a] += share[j] * (x[j, a] + f[j, 0, 1] * x[j, 3 + a] + f[j, 0, 2] * x[j, 6 + a])


class PoseRow(NamedTuple):
    """One person of a pose: positions (K, 3), covariances (K, 3, 3), rms px (K,), views (K,), kind (K,)."""

    xyz: Array
    cov: Array
    reproj: Array
    n_views: Array
    kind: Array


@kernel()
def where(state, t, session, means, sigmas):
    """Positions (K, 3) expected at time t and how sure (K,), standard deviation; NaN where not tracked."""
    person = parts(state, session)
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
def pose(state, t, session, kinds, out):
    """What comes out at time t, filled into out; kinds: FUSED and PREDICTED."""
    rules = session.rules
    person = parts(state, session)
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
                information[a, d] += w * across + deepness[c] * cameras[c, 6 + a] * cameras[c, 6 + d]
    inverse3(information, inverse)
    for a in range(3):
        for d in range(3):
            spread[a, d] += rules.lasting_share * inverse[a, d]


# a limb of a view is exchanged where that brings it so much closer
_CLEARLY = 0.5


@kernel()
def rays_of_person(before, t, later_s, view, session, z, inverse_var, then):
    """Fill z (K, 2) and inverse_var (K,) of a view at time t, and where keypoints were (K, 3) when their rows were exposed.

    before: the states to start from for the time t and for `later_s` after it, between which a keypoint moves from row to row.
    z is NaN, and inverse_var 0, where there is none.
    """
    _expected(before[0], t, session, then)
    if view.late_s.any():
        later = np.empty(then.shape)
        _expected(before[1], t + later_s, session, later)
        for i in range(len(then)):
            for a in range(3):
                then[i, a] += (later[i, a] - then[i, a]) * (view.late_s[i] / later_s)
    source = sources(_exchanged(view, then, session), session)
    for i in range(len(source)):
        total = 0.0
        for a in range(2):
            z[i, a] = view.z[source[i], a]
            for b in range(2):
                total += view.white[source[i], a, b] ** 2
        inverse_var[i] = 0.5 * total if math.isfinite(z[i, 0]) else 0.0


@kernel()
def _expected(state, t, session, means):
    """Positions (K, 3) at a time."""
    person = parts(state, session)
    places(person, all_models(t - person.time[0], session.models)[0], means)


@kernel()
def _exchanged(view, places, session):
    """(GROUPS,) 1 for each limb whose sides a view exchanges, given where the keypoints are (K, 3)."""
    camera = session.cameras[view.camera]
    same, other, there = np.zeros(GROUPS), np.zeros(GROUPS), np.empty(3)
    for i in range(len(places)):
        g, mirror = session.group[i], session.mirror[i]
        if g < 0:
            continue
        for a in range(3):
            there[a] = camera[9 + a]
            for b in range(3):
                there[a] += camera[3 * a + b] * places[i, b]
        u, v = there[0] / there[2], there[1] / there[2]
        own = math.hypot(view.z[i, 0] - u, view.z[i, 1] - v)
        mirrored = math.hypot(view.z[mirror, 0] - u, view.z[mirror, 1] - v)
        if math.isfinite(own) and math.isfinite(mirrored):
            same[g] += own
            other[g] += mirrored
    exchanged = np.zeros(GROUPS)
    for g in range(GROUPS):
        if other[g] < _CLEARLY * same[g]:
            exchanged[g] = 1.0
    return exchanged
