"""One view of one person applied: the state before it becomes the state after it."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

from .body import alone, centre_body, hold_depth, learn_bones, let_go_of_strays, start_missing
from .motion import all_models, combined, forward, learn_liveliness, mix
from .rays import depth_row, expected, ray, squared, whitened
from .sides import exchange_person, flipped_groups
from .state import GROUPS, parts
from .updates import doubt, move_body, update, update_depth

FIGURES = 6  # of one view: keypoints measured, gated, sum of squared sigmas, exchanged limbs; the body's speed; depths used
_FLIP_MEMORY = 0.05  # weight of the newest view in the share of exchanged ones
_FLIP_STATE = 0.6  # when so many views are exchanged it is the person who is
_REFUSED_MOST = 4.0  # a keypoint that so many views in a row put elsewhere is elsewhere


@kernel()
def step(
    before, after, t, c, z, white, late, px_scale, cameras, mirror, group, neighbours, ends, sizes, models, rules, figures,
    deep=None,
):  # fmt: skip
    """One view into a person: state `before` -> `after`, at time t not before it.

    Args:
        c: camera. z (K, 2) ideal points, NaN where unseen; white (K, 2, 2); late (K,) how much after t a row was exposed.
        px_scale: (K,) pixels per sigma. cameras: (C, 15). mirror, group: (K,). neighbours: (K, n), -1 for none.
        ends: (B, 2). sizes: (K, M, C, B). models: (2, M, 2) acceleration of keypoints and of the body, and how long it lasts.
        rules: outlier, gate, switch_s, lost_after_s, new_share, alone_hold_s. figures: (FIGURES,) filled.
        deep: (K, 2) depth of each keypoint and its sigma, m, NaN where unknown; None compiles a kernel without any of it.
    """
    k, m, count, b = sizes
    after[:] = before
    x, cov, share, lively, seen, square, precision, deepness, refused, flips, bones, time = parts(after, k, m, count, b)
    dt = t - time[0]
    time[0] = t
    figures[:] = 0.0
    start_missing(x, cov, seen, z, t, rules[3], neighbours, models[0, :, 0])
    means, spreads = np.full((k + 1, 3), np.nan), np.empty((k + 1, 3, 3))
    _carried_on(x, cov, share, dt, rules[2], models, means, spreads)
    exchanged = np.zeros(GROUPS)
    wheres, wide = means[:k] + means[k], spreads[:k] + spreads[k]
    flipped_groups(cameras[c], z, white, wheres, wide, mirror, group, exchanged)
    depths = move_body(
        cameras[c], z, white, late, x, cov, share, means, spreads, mirror, group, exchanged, rules, deep
    )  # fmt: skip
    _work_in(
        cameras[c], c, t, z, white, late, px_scale, x, cov, share, means, spreads, seen, square, precision, refused,
        mirror, group, exchanged, rules, figures, deepness, deep,
    )  # fmt: skip
    for g in range(GROUPS):
        figures[3] += exchanged[g]
        flips[g] += _FLIP_MEMORY * (exchanged[g] - flips[g])
        if flips[g] > _FLIP_STATE:
            exchange_person(x, cov, share, seen, square, precision, deepness, mirror, group, g)
            flips[g] = 0.0
    let_go_of_strays(x[:k], share, means[:k])
    learn_bones(bones, ends, means, spreads)
    learn_liveliness(lively, share, models, dt)
    centre_body(x, share)
    if depths == 0 and alone(seen, c, t) > rules[5]:
        old = parts(before, k, m, count, b)
        hold_depth(cameras[c], dt, old[0][k], old[2][k], x[k], cov[k], share[k])
    figures[4], figures[5] = _body_speed(x[k], share[k]), depths


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
def _carried_on(x, cov, share, dt, switch_s, models, means, spreads):
    """Everybody `dt` later, in place, models mixed; fills places (K + 1, 3) and their covariances (K + 1, 3, 3)."""
    k, m = len(x) - 1, x.shape[1]
    stay = math.exp(-dt / switch_s)
    f, q = all_models(dt, models)
    mixed_x, mixed_cov, mixed_share = np.empty((m, 9)), np.empty((m, 9, 9)), np.empty(m)
    for i in range(k + 1):
        if not math.isfinite(x[i, 0, 0]):
            continue
        if dt > 0.0:
            mix(x[i], cov[i], share[i], stay, mixed_x, mixed_cov, mixed_share)
            whose = 1 if i == k else 0
            for j in range(m):
                forward(mixed_x[j], mixed_cov[j], f[whose, j], q[whose, j])
            x[i], cov[i], share[i] = mixed_x, mixed_cov, mixed_share
        combined(x[i], cov[i], share[i], means[i], spreads[i])


@kernel()
def _work_in(
    camera, c, t, z, white, late, px_scale, x, cov, share, means, spreads, seen, square, precision, refused, mirror,
    group, exchanged, rules, figures, deepness, deep=None,
):  # fmt: skip
    """Every keypoint's ray into the keypoint itself, once the body has moved; fills figures but for the exchanged limbs."""
    k, m = len(z), x.shape[1]
    body = np.zeros(3)
    for a in range(3):
        for j in range(m):
            body[a] += share[k, j] * x[k, j, 3 + a]
    h, slope, rows, error, row, far = np.empty(2), np.empty((2, 3)), np.empty((2, 3)), np.empty(2), np.empty(3), np.empty(m)
    point, before_m, away = np.empty(3), np.empty(3), np.empty((m, 2))
    for i in range(k):
        o = mirror[i] if group[i] >= 0 and exchanged[group[i]] > 0.0 else i
        if not (math.isfinite(z[o, 0]) and math.isfinite(means[i, 0])):
            continue
        for a in range(3):
            drift = body[a]
            for j in range(m):
                drift += share[i, j] * x[i, j, 3 + a]
            before_m[a] = means[i, a]
            point[a] = means[k, a] + means[i, a] + late[o] * drift
        if not ray(camera, point, h, slope):
            continue
        whitened(white[o], slope, z[o], h, rows, error)
        for j in range(m):
            for r in range(2):
                away[j, r] = error[r]
                for a in range(3):
                    away[j, r] -= rows[r, a] * (x[i, j, a] - means[i, a])
        s00, s01, s11 = expected(rows, spreads[i] + spreads[k], 1.0)
        figures[0] += 1.0
        figures[2] += min(squared(s00, s01, s11, error[0], error[1]), 4.0 * rules[1])
        nearest = update(x[i], cov[i], share[i], rows, away, rules[4], spreads[k], rules[0], rules[1])
        if not nearest <= rules[1]:
            figures[1] += 1.0
            refused[i] += 1.0
            if refused[i] >= _REFUSED_MOST:
                refused[i] = 0.0
                doubt(cov[i])
            continue
        refused[i] = 0.0
        seen[i, c] = t
        combined(x[i], cov[i], share[i], means[i], spreads[i])
        for a in range(3):
            point[a] += means[i, a] - before_m[a]
        if deep is not None:
            deepness[i, c] = 0.0
            if deep[o, 1] > 0.0:
                miss = depth_row(camera, point, deep[o], row)
                for j in range(m):
                    far[j] = miss
                    for a in range(3):
                        far[j] -= row[a] * (x[i, j, a] - means[i, a])
                if update_depth(x[i], cov[i], share[i], row, far, spreads[k], rules[0], rules[1]):
                    deepness[i, c] = 1.0 / deep[o, 1] ** 2
                    for a in range(3):
                        before_m[a] = means[i, a]
                    combined(x[i], cov[i], share[i], means[i], spreads[i])
                    for a in range(3):
                        point[a] += means[i, a] - before_m[a]
        if ray(camera, point, h, slope):
            whitened(white[o], slope, z[o], h, rows, error)
            square[i, c] = (error[0] ** 2 + error[1] ** 2) * px_scale[o] ** 2
        precision[i, c] = 0.5 * (white[o, 0, 0] ** 2 + white[o, 0, 1] ** 2 + white[o, 1, 0] ** 2 + white[o, 1, 1] ** 2)
