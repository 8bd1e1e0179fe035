"""What a live fit needs at every output tick."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

from .tree import forward, place


@kernel()
def points(tree, q, rot):
    """Places (A, 3) of the tree's keypoints."""
    parent, kind, axis, offset, _, _, _, node, local = tree
    frame, origin = np.empty((kind.shape[0], 3, 3)), np.empty((kind.shape[0], 3))
    forward(parent, kind, axis, offset, q, rot, frame, origin)
    out = np.empty((node.shape[0], 3))
    for p in range(node.shape[0]):
        out[p] = place(frame, origin, node[p], local[p])
    return out


@kernel()
def weighted_points(xyz, cov, share):
    """Points (A, 3) without NaN, and `share` of the inverses of their covariances (A, 3, 3); 0 where one is missing."""
    out, information = np.zeros(xyz.shape), np.zeros(cov.shape)
    for p in range(xyz.shape[0]):
        c = cov[p]
        a, b, d = c[1, 1] * c[2, 2] - c[1, 2] ** 2, c[0, 2] * c[1, 2] - c[0, 1] * c[2, 2], c[0, 1] * c[1, 2] - c[0, 2] * c[1, 1]
        det = c[0, 0] * a + c[0, 1] * b + c[0, 2] * d
        if not (math.isfinite(xyz[p, 0]) and det > 0.0):
            continue
        out[p] = xyz[p]
        m, scale = information[p], share / det
        m[0, 0], m[0, 1], m[0, 2] = a * scale, b * scale, d * scale
        m[1, 1] = (c[0, 0] * c[2, 2] - c[0, 2] ** 2) * scale
        m[1, 2] = (c[0, 1] * c[0, 2] - c[0, 0] * c[1, 2]) * scale
        m[2, 2] = (c[0, 0] * c[1, 1] - c[0, 1] ** 2) * scale
        m[1, 0], m[2, 0], m[2, 1] = m[0, 1], m[0, 2], m[1, 2]
    return out, information


@kernel()
def stand(xyz, elapsed_s, rules, last, place, off, velocity, slow_s, stands):
    """Points (R, 3) of soles: what hardly moves stands at its mean place; see `standing.StandingFeet`.

    Everything from `last` on is what is remembered of each point, changed in place. rules: limit of the speed in m/s, how long it
    must have held in s, time over which speed is a mean in s, farthest from the place in m, time in which a foot that lifts
    comes back to where it is tracked in s.
    """
    slow_m_s, least_s, speed_s, left_m, fade_s = rules
    fresh, kept = 1.0 - math.exp(-elapsed_s / speed_s), math.exp(-elapsed_s / fade_s)
    for r in range(xyz.shape[0]):
        known = elapsed_s > 0.0 and math.isfinite(xyz[r, 0]) and math.isfinite(last[r, 0])
        speed, away = 0.0, 0.0
        for i in range(3):
            if known:
                velocity[r, i] += fresh * ((xyz[r, i] - last[r, i]) / elapsed_s - velocity[r, i])
            else:
                velocity[r, i] = 0.0
            speed += velocity[r, i] ** 2
            away += (xyz[r, i] - place[r, i]) ** 2
        slow = known and speed < slow_m_s**2 and away < left_m**2
        slow_s[r] = slow_s[r] + elapsed_s if slow else 0.0
        stands[r] = slow_s[r] >= least_s
        for i in range(3):
            if slow:
                place[r, i] += elapsed_s / slow_s[r] * (xyz[r, i] - place[r, i])
            else:
                place[r, i] = xyz[r, i]
            off[r, i] = place[r, i] - xyz[r, i] if stands[r] else kept * off[r, i]
            last[r, i] = xyz[r, i]
