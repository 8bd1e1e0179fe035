"""One view of one person applied: the state before it becomes the state after it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from posefuse.foundation.compiled import kernel

from .body import alone, centre_body, drop_strays, hold_depth, learn_bones, start_missing
from .rays import depth_row, expected, ray, squared, swap_person, swapped_groups
from .state import GROUPS, all_models, combined, learn_liveliness, mix, predict_model
from .updates import move_body, update

_SWAP_MEMORY = 0.05  # weight of the newest view in the share of swapped ones
_SWAP_STATE = 0.6  # when so many views are swapped it is the person who is


class ViewFigures(NamedTuple):
    """Of one view of one person.

    measured: keypoints with a ray. gated: those of them that were too far off to be used. square: sum of their squared sigmas.
    speed_m_s: of the body after the view. depths: used for the body.
    """

    measured: float
    gated: float
    square: float
    speed_m_s: float
    depths: float


@kernel()
def step(person, t, view, session, deep=None):
    """One view into a person, in place, at time t not before the person's; returns `ViewFigures`.

    deep: (K, 2) depth of each keypoint and its sigma, m, NaN where unknown; None compiles a kernel without any of it.
    """
    k, c = len(view.z), view.camera
    body_before, share_before = person.x[k].copy(), person.share[k].copy()
    dt = t - person.time[0]
    person.time[0] = t
    start_missing(person, view.z, t, session)
    means, spreads = np.full((k + 1, 3), np.nan), np.empty((k + 1, 3, 3))
    _carried_on(person, dt, session, means, spreads)
    swapped = np.zeros(GROUPS)
    wheres, wide = means[:k] + means[k], spreads[:k] + spreads[k]
    swapped_groups(view, wheres, wide, session, swapped)
    source = sources(swapped, session)
    depths = move_body(view, source, person, means, spreads, session, deep)
    measured, gated, square = _work_in(view, t, source, person, means, spreads, session, deep)
    for g in range(GROUPS):
        person.swaps[g] += _SWAP_MEMORY * (swapped[g] - person.swaps[g])
        if person.swaps[g] > _SWAP_STATE:
            swap_person(person, session, g)
            person.swaps[g] = 0.0
    drop_strays(person.x[:k], means[:k])
    learn_bones(person.bones, session.ends, means, spreads)
    learn_liveliness(person.lively, person.share, session.models, dt)
    centre_body(person.x, person.share)
    if depths == 0 and alone(person.seen, c, t) > session.rules.alone_hold_s:
        hold_depth(session.cameras[c], dt, body_before, share_before, person.x[k], person.cov[k], person.share[k])
    return ViewFigures(measured, gated, square, _body_speed(person.x[k], person.share[k]), float(depths))


@kernel()
def sources(swapped, session):
    """(K,) which keypoint of the view each one of the person is: its counterpart where its limb is swapped (GROUPS,)."""
    source = np.arange(len(session.mirror))
    for i in range(len(source)):
        if session.group[i] >= 0 and swapped[session.group[i]] > 0.0:
            source[i] = session.mirror[i]
    return source


@kernel()
def _body_speed(x, share):
    """m/s over the models (M, 9)."""
    square = 0.0
    for a in range(3):
        along = 0.0
        for j in range(len(share)):
            along += share[j] * x[j, 3 + a]
        square += along * along
    return math.sqrt(square)


@kernel()
def _carried_on(person, dt, session, means, spreads):
    """Everybody `dt` later, in place, models mixed; fills places (K + 1, 3) and their covariances (K + 1, 3, 3)."""
    x, cov, share = person.x, person.cov, person.share
    k, m = len(x) - 1, x.shape[1]
    stay = math.exp(-dt / session.rules.switch_s)
    f, q = all_models(dt, session.models)
    mixed_x, mixed_cov, mixed_share = np.empty((m, 9)), np.empty((m, 9, 9)), np.empty(m)
    for i in range(k + 1):
        if not math.isfinite(x[i, 0, 0]):
            continue
        if dt > 0.0:
            mix(x[i], cov[i], share[i], stay, mixed_x, mixed_cov, mixed_share)
            whose = 1 if i == k else 0
            for j in range(m):
                predict_model(mixed_x[j], mixed_cov[j], f[whose, j], q[whose, j])
            x[i], cov[i], share[i] = mixed_x, mixed_cov, mixed_share
        combined(x[i], cov[i], share[i], means[i], spreads[i])


@kernel()
def _work_in(view, t, source, person, means, spreads, session, deep=None):
    """Every keypoint's ray into the keypoint itself, once the body has moved; returns the first three of `ViewFigures`."""
    z, white, late, c = view.z, view.white, view.late_s, view.camera
    x, cov, share = person.x, person.cov, person.share
    camera, rules = session.cameras[c], session.rules
    measured, gated, square = 0.0, 0.0, 0.0
    k, m = len(z), x.shape[1]
    body = np.zeros(3)
    for a in range(3):
        for j in range(m):
            body[a] += share[k, j] * x[k, j, 3 + a]
    rows, error, away = np.empty((2, 3)), np.empty(2), np.empty((m, 2))
    point, before_m = np.empty(3), np.empty(3)
    for i in range(k):
        o = source[i]
        if not (math.isfinite(z[o, 0]) and math.isfinite(means[i, 0])):
            continue
        for a in range(3):
            drift = body[a]
            for j in range(m):
                drift += share[i, j] * x[i, j, 3 + a]
            before_m[a] = means[i, a]
            point[a] = means[k, a] + means[i, a] + late[o] * drift
        if not ray(camera, point, white[o], z[o], rows, error):
            continue
        for j in range(m):
            for r in range(2):
                away[j, r] = error[r]
                for a in range(3):
                    away[j, r] -= rows[r, a] * (x[i, j, a] - means[i, a])
        s00, s01, s11 = expected(rows, spreads[i] + spreads[k], 1.0)
        measured += 1.0
        square += min(squared(s00, s01, s11, error[0], error[1]), 4.0 * rules.gate_chi2)
        nearest = update(x[i], cov[i], share[i], rows, away, spreads[k], rules.new_share, rules)
        if not nearest <= rules.gate_chi2:
            gated += 1.0
            continue
        person.seen[i, c] = t
        combined(x[i], cov[i], share[i], means[i], spreads[i])
        for a in range(3):
            point[a] += means[i, a] - before_m[a]
        if deep is not None:
            person.deepness[i, c] = _depth_in(deep[o], i, person, camera, point, means[i], spreads[i], spreads[k], rules)
        if ray(camera, point, white[o], z[o], rows, error):
            person.square[i, c] = (error[0] ** 2 + error[1] ** 2) * view.sigma_px[o] ** 2
        person.precision[i, c] = 0.5 * (white[o, 0, 0] ** 2 + white[o, 0, 1] ** 2 + white[o, 1, 0] ** 2 + white[o, 1, 1] ** 2)
    return measured, gated, square


@kernel()
def _depth_in(measured, i, person, camera, point, mean, spread, common, rules):
    """A measured depth (2,) into keypoint i, whose place `point` in the world moves with it; 1/variance, 0 if not used."""
    x, cov, share = person.x[i], person.cov[i], person.share[i]
    if not measured[1] > 0.0:
        return 0.0
    rows, before_m, away = np.zeros((2, 3)), mean.copy(), np.zeros((len(share), 2))
    miss = depth_row(camera, point, measured, rows[0])
    for j in range(len(share)):
        away[j, 0] = miss
        for a in range(3):
            away[j, 0] -= rows[0, a] * (x[j, a] - mean[a])
    if not update(x, cov, share, rows, away, common, 1.0, rules) <= rules.gate_chi2:
        return 0.0
    combined(x, cov, share, mean, spread)
    for a in range(3):
        point[a] += mean[a] - before_m[a]
    return 1.0 / measured[1] ** 2
