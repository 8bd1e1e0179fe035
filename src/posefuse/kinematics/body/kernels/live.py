"""What a live fit needs at every output tick."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel


@kernel()
def moved_rays(projections, z, inverse_var, then, now, least_depth_m, xy, known_var):
    """Fill xy (V, K, 2) and known_var (V, K), 0 where there is none: rays z moved as their points did, `then` (V, K, 3) to `now`.

    A point nearer to a camera than `least_depth_m`, then or now, has no ray.
    """
    for v in range(len(z)):
        for k in range(len(now)):
            xy[v, k], known_var[v, k] = 0.0, 0.0
            before, after = projected(projections[v], then[v, k]), projected(projections[v], now[k])
            if not (before[2] > least_depth_m and after[2] > least_depth_m and math.isfinite(z[v, k, 0])):
                continue
            xy[v, k, 0], xy[v, k, 1] = z[v, k, 0] + after[0] - before[0], z[v, k, 1] + after[1] - before[1]
            known_var[v, k] = inverse_var[v, k]


@kernel()
def projected(projection, x):
    """Image point of x in a camera (3, 4), and its depth."""
    u = projection[0, 0] * x[0] + projection[0, 1] * x[1] + projection[0, 2] * x[2] + projection[0, 3]
    v = projection[1, 0] * x[0] + projection[1, 1] * x[1] + projection[1, 2] * x[2] + projection[1, 3]
    w = projection[2, 0] * x[0] + projection[2, 1] * x[1] + projection[2, 2] * x[2] + projection[2, 3]
    return u / w, v / w, w


@kernel()
def _missed(x, projection, xy, inverse_var):
    """Squared distance of a ray from x in standard deviations; NaN where either is unseen."""
    if not inverse_var > 0.0:
        return np.nan
    u, v, _ = projected(projection, x)
    return ((u - xy[0]) ** 2 + (v - xy[1]) ** 2) * inverse_var


@kernel()
def variance_factor(points, projections, xy, inverse_var):
    """(K,) by how much rays that meet near points (K, 3) are farther apart than stated, see `live.LiveRays`."""
    out = np.ones(len(points))
    for k in range(len(points)):
        total, freedom = 0.0, -3
        for v in range(len(projections)):
            squared = _missed(points[k], projections[v], xy[v, k], inverse_var[v, k])
            if math.isfinite(squared):
                total += squared
                freedom += 2
        if freedom > 0:
            out[k] = max(1.0, total / freedom)
    return out


@kernel()
def ray_loss(points, at, projections, xy, inverse_var, most):
    """Mean of the squared distances of points (A, 3) from the rays of keypoints `at` (A,), by coordinate, none above `most`."""
    total, count = 0.0, 0
    for a in range(len(at)):
        for v in range(len(projections)):
            squared = 0.5 * _missed(points[a], projections[v], xy[v, at[a]], inverse_var[v, at[a]])
            if math.isfinite(squared):
                total += min(squared, most)
                count += 1
    return total / count if count > 0 else 0.0


@kernel()
def weighted_points(xyz, cov, at, share):
    """Points (A, 3) without NaN, and `share` of the inverses of the covariances (A, 3, 3) of keypoints `at`; 0 where missing."""
    out, information = np.zeros(xyz.shape), np.zeros((len(at), 3, 3))
    for p in range(xyz.shape[0]):
        c = cov[at[p]]
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
