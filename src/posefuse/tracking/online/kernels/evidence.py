"""The rays of a view that is kept, for its person: left and right in order, and where the keypoints were at its time."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

from .motion import all_models
from .pose import places
from .state import GROUPS, parts
from .step import sources

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
