"""Left and right exchanged, in a view or in the person."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

from .rays import expected, ray, squared, whitened
from .state import GROUPS, parts

_FLIP_GAIN = 12.0  # least loss saved by exchanging a limb: noise does not exchange
_FLIP_OBJECTION = 4.0  # least additional loss for which a limb supports its own sides
_FLIP_MOST = 16.0  # largest contribution of a keypoint


@kernel()
def flipped_groups(view, means, spreads, session, out):
    """out (GROUPS,): which limbs fit clearly better with left and right exchanged."""
    z, white, camera = view.z, view.white, session.cameras[view.camera]
    gain = np.zeros(GROUPS)
    h, slope, rows, error, point = np.empty(2), np.empty((2, 3)), np.empty((2, 3)), np.empty(2), np.empty(3)
    for i in range(len(z)):
        g, o = session.group[i], session.mirror[i]
        if g < 0 or not (math.isfinite(z[i, 0]) and math.isfinite(z[o, 0]) and math.isfinite(means[i, 0])):
            continue
        for turn in range(2):
            k = i if turn == 0 else o
            for a in range(3):
                point[a] = means[i, a]
            if not ray(camera, point, h, slope):
                continue
            whitened(white[k], slope, z[k], h, rows, error)
            s00, s01, s11 = expected(rows, spreads[i], 1.0)
            loss = min(squared(s00, s01, s11, error[0], error[1]), _FLIP_MOST)
            gain[g] += loss if turn == 0 else -loss
    # the whole body is swapped when no limb contradicts: eyes and ears alone are too close together to decide
    whole = gain.sum() > _FLIP_GAIN and gain.min() > -_FLIP_OBJECTION
    for g in range(GROUPS):
        out[g] = whole or gain[g] > _FLIP_GAIN


@kernel()
def exchange_person(person, session, g):
    """Exchange left and right of one limb of the person."""
    x, cov, share = person.x, person.cov, person.share
    for i in range(len(session.mirror)):
        o = session.mirror[i]
        if session.group[i] == g and i < o:
            kept_x, kept_cov, kept_share = x[i].copy(), cov[i].copy(), share[i].copy()
            x[i], cov[i], share[i] = x[o], cov[o], share[o]
            x[o], cov[o], share[o] = kept_x, kept_cov, kept_share
            for of_keypoint in (person.lively, person.refused):
                of_keypoint[i], of_keypoint[o] = of_keypoint[o], of_keypoint[i]
            for of_camera in (person.seen, person.square, person.precision, person.deepness):
                for c in range(of_camera.shape[1]):
                    of_camera[i, c], of_camera[o, c] = of_camera[o, c], of_camera[i, c]


@kernel()
def exchange_groups(state, session, which):
    """Exchange left and right of the limbs `which` (GROUPS,) of a person, and forget the views in which they were exchanged."""
    person = parts(state, session)
    for g in range(GROUPS):
        if which[g]:
            exchange_person(person, session, g)
            person.flips[g] = 0.0
