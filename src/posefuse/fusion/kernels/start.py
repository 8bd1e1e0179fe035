"""First answers for a point: linear from all views, from pairs of views, and the one that most views agree with."""

from __future__ import annotations

import math

from .cameras import R00, R01, R02, R10, R11, R12, R20, R21, R22, TX, TY, TZ, X, Y, Z, fast_kernel
from .point import loss, solve3, squared_residual

GATE = 13.8  # 99.9 %: all views within it need no consensus search
MAX_TRIALS = 120  # all pairs of 16 cameras: smaller rigs are searched in full where no clean pair ends the search before


@fast_kernel()
def add_row(system, weight, a0, a1, a2, e):
    """One equation a . p + e = 0 into normal equations."""
    system[0] += weight * a0 * a0
    system[1] += weight * a0 * a1
    system[2] += weight * a0 * a2
    system[3] += weight * a1 * a1
    system[4] += weight * a1 * a2
    system[5] += weight * a2 * a2
    system[6] += weight * a0 * e
    system[7] += weight * a1 * e
    system[8] += weight * a2 * e


@fast_kernel()
def depth_rows(cams, views, i):
    """Depth-scaled residuals of view i as rows: (x m3 - m1) . (p, 1) and (y m3 - m2) . (p, 1) in ideal coordinates."""
    c, x, y = int(views[i, 6]), views[i, 0], views[i, 1]
    r20, r21, r22, tz = cams[c, R20], cams[c, R21], cams[c, R22], cams[c, TZ]
    return (
        x * r20 - cams[c, R00],
        x * r21 - cams[c, R01],
        x * r22 - cams[c, R02],
        x * tz - cams[c, TX],
        y * r20 - cams[c, R10],
        y * r21 - cams[c, R11],
        y * r22 - cams[c, R12],
        y * tz - cams[c, TY],
    )


@fast_kernel()
def linear_start(cams, views, n, p, system):
    """Depth-scaled whitened linear least squares over all views into p; False when the rays do not define a point."""
    for i in range(9):
        system[i] = 0.0
    for i in range(n):
        a0, a1, a2, a3, b0, b1, b2, b3 = depth_rows(cams, views, i)
        w0, w1, w2, w3 = views[i, 2], views[i, 3], views[i, 4], views[i, 5]
        add_row(system, 1.0, w0 * a0 + w1 * b0, w0 * a1 + w1 * b1, w0 * a2 + w1 * b2, w0 * a3 + w1 * b3)
        add_row(system, 1.0, w2 * a0 + w3 * b0, w2 * a1 + w3 * b1, w2 * a2 + w3 * b2, w2 * a3 + w3 * b3)
    return solve3(system, 0.0, p)


@fast_kernel()
def pair_point(cams, views, i, j, p):
    """Point nearest to two rays into p (their common perpendicular's middle); False for parallel rays."""
    one, two = views[i], views[j]
    cam, other = cams[int(one[6])], cams[int(two[6])]
    d0 = cam[R00] * one[0] + cam[R10] * one[1] + cam[R20]
    d1 = cam[R01] * one[0] + cam[R11] * one[1] + cam[R21]
    d2 = cam[R02] * one[0] + cam[R12] * one[1] + cam[R22]
    f0 = other[R00] * two[0] + other[R10] * two[1] + other[R20]
    f1 = other[R01] * two[0] + other[R11] * two[1] + other[R21]
    f2 = other[R02] * two[0] + other[R12] * two[1] + other[R22]
    b0, b1, b2 = other[X] - cam[X], other[Y] - cam[Y], other[Z] - cam[Z]
    dd, ff, df = d0 * d0 + d1 * d1 + d2 * d2, f0 * f0 + f1 * f1 + f2 * f2, d0 * f0 + d1 * f1 + d2 * f2
    det = dd * ff - df * df
    if not det > 1e-6 * dd * ff:
        return False
    bd, bf = b0 * d0 + b1 * d1 + b2 * d2, b0 * f0 + b1 * f1 + b2 * f2
    s, t = (bd * ff - bf * df) / det, (bd * df - bf * dd) / det
    p[0] = 0.5 * (cam[X] + s * d0 + other[X] + t * f0)
    p[1] = 0.5 * (cam[Y] + s * d1 + other[Y] + t * f1)
    p[2] = 0.5 * (cam[Z] + s * d2 + other[Z] + t * f2)
    return True


@fast_kernel()
def depth_point(cams, views, i, planes, p):
    """Point of view i at its depth into p; False where it has none."""
    if not planes[i, 1] > 0.0:
        return False
    cam, z = cams[int(views[i, 6])], planes[i, 0]
    x, y = views[i, 0] * z - cam[TX], views[i, 1] * z - cam[TY]
    z -= cam[TZ]
    for a in range(3):
        p[a] = cam[R00 + a] * x + cam[R10 + a] * y + cam[R20 + a] * z
    return True


@fast_kernel()
def consensus(cams, views, n, p, trial):
    """Best two-ray point under the robust loss into p; at most MAX_TRIALS pairs, fewer once a better one is unlikely.

    Pairs go round the cameras with a growing stride, so early ones differ in both cameras.
    """
    best = math.inf
    trials = 0
    enough = float(MAX_TRIALS)
    first = max(1, n // 3)
    for turn in range(n // 2):
        stride = 1 + (first - 1 + turn) % (n // 2)
        for i in range(n if 2 * stride < n else n // 2):
            if trials >= enough:
                return best
            trials += 1
            if not pair_point(cams, views, i, (i + stride) % n, trial):
                continue
            total, inliers = 0.0, 0
            for j in range(n):
                s = squared_residual(cams, views, j, trial)
                total += loss(s)
                inliers += s < GATE
                if total >= best:
                    break
            if total < best:
                best = total
                p[:] = trial[:3]
                share = (inliers / n) ** 2
                # all pairs but one in a thousand orders would have met a clean pair by then
                enough = math.log(1e-3) / math.log(1.0 - share) if 0.0 < share < 1.0 else float(MAX_TRIALS)
                enough = max(3.0, min(enough, float(MAX_TRIALS))) if share < 1.0 else 0.0
    return best
