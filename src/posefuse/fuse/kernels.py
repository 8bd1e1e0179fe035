"""The compiled mathematics of fusion: lens, residuals, consensus, robust Gauss-Newton, covariance.

One file on purpose: numba's disk cache watches only the file of the function it compiled, so a kernel whose callee
lived elsewhere would go stale unseen.

A group is one person at one instant: K keypoints seen by C cameras. Cameras come as rows of `packed.packed_rig`.
Residuals are whitened: e = J (x_projected - x_seen) / sigma in ideal image-plane coordinates, J = d(raw px)/d(ideal),
so |e|^2 is the squared pixel error in units of its variance and cameras of any lens and resolution add up.

Robust loss of s = |e|^2: s up to `KNEE`, then 2 KNEE - KNEE^2 / s: quadratic where noise lives (efficient, so the
inverse information is the covariance) and bounded like Geman-McClure where outliers live (a wrong view cannot pull).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

KNEE = 9.0  # 98.9 % of a 2D Gaussian
GATE = 13.8  # 99.9 %: all views within it need no consensus search
USED = 28.0  # weight (KNEE / s)^2 of 0.1: beyond it a view no longer counts as used
RANK = 1e-10  # smallest over largest eigenvalue of the information below which the rays are one ray
PRIOR_DOF = 8.0  # how many residuals the stated sigma is worth when residuals contradict it
RESCALE = 2.0  # squared ratio of seen to stated noise from which the stated sigma is taken as wrong
MIN_POINTS = 5  # of three or more views, to judge the stated sigma by
MAX_TRIALS = 120
ATTEMPTS = 5
MIN_SCALE = 0.25
MAX_SCALE = 10.0  # beyond it the views are taken to be wrong rather than the stated sigma
LAST_SCALE = 20.0  # of 1.5 % of a body: a third of it, beyond which views do not show the same one

_JIT = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "arcp", "nsz"}}


@njit(**_JIT)
def bend(cam, x, y):
    """Raw px (u, v) of an ideal point and their derivatives (u_x, u_y, v_x, v_y)."""
    model = cam[47]
    bx, by, a, b, c, d = x, y, 1.0, 0.0, 0.0, 1.0
    if model == 3.0:
        bx, by, a, b, c, d = _bend_fisheye(cam, x, y)
    elif model > 0.0:
        bx, by, a, b, c, d = _bend_brown(cam, x, y)
        if model == 2.0:
            bx, by, a, b, c, d = _tilt(cam, bx, by, a, b, c, d)
    fx, skew, fy = cam[12], cam[13], cam[15]
    return (
        fx * bx + skew * by + cam[14],
        fy * by + cam[16],
        fx * a + skew * c,
        fx * b + skew * d,
        fy * c,
        fy * d,
    )


@njit(**_JIT)
def _bend_brown(cam, x, y):
    return _brown(
        x, y, cam[17], cam[18], cam[19], cam[20], cam[21], cam[22], cam[23], cam[24], cam[25], cam[26], cam[27], cam[28]
    )  # fmt: skip


@njit(inline="always", **_JIT)
def _brown(x, y, k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4):
    r2 = x * x + y * y
    over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    d_over = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)
    under = 1.0 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    gain = over * under
    d_gain = (d_over - gain * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6))) * under
    bx = x * gain + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2)
    by = y * gain + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + r2 * s4)
    ex, ey = s1 + 2.0 * r2 * s2, s3 + 2.0 * r2 * s4
    a = gain + 2.0 * x * x * d_gain + 2.0 * p1 * y + 6.0 * p2 * x + 2.0 * x * ex
    b = 2.0 * x * y * d_gain + 2.0 * p1 * x + 2.0 * p2 * y + 2.0 * y * ex
    c = 2.0 * x * y * d_gain + 2.0 * p1 * x + 2.0 * p2 * y + 2.0 * x * ey
    d = gain + 2.0 * y * y * d_gain + 6.0 * p1 * y + 2.0 * p2 * x + 2.0 * y * ey
    return bx, by, a, b, c, d


@njit(**_JIT)
def _tilt(cam, bx, by, a, b, c, d):
    w = 1.0 / (cam[35] * bx + cam[36] * by + cam[37])
    u = (cam[29] * bx + cam[30] * by + cam[31]) * w
    v = (cam[32] * bx + cam[33] * by + cam[34]) * w
    ux, uy = (cam[29] - u * cam[35]) * w, (cam[30] - u * cam[36]) * w
    vx, vy = (cam[32] - v * cam[35]) * w, (cam[33] - v * cam[36]) * w
    return u, v, ux * a + uy * c, ux * b + uy * d, vx * a + vy * c, vx * b + vy * d


@njit(**_JIT)
def _bend_fisheye(cam, x, y):
    r = math.sqrt(x * x + y * y)
    if r < 1e-9:
        return x, y, 1.0, 0.0, 0.0, 1.0
    angle = math.atan(r)
    a2 = angle * angle
    bent = angle * (1.0 + a2 * (cam[17] + a2 * (cam[18] + a2 * (cam[19] + a2 * cam[20]))))
    slope = 1.0 + a2 * (3.0 * cam[17] + a2 * (5.0 * cam[18] + a2 * (7.0 * cam[19] + a2 * 9.0 * cam[20])))
    gain = bent / r
    d_gain = (slope / (1.0 + r * r) - gain) / (r * r)
    cross = x * y * d_gain
    return x * gain, y * gain, gain + x * x * d_gain, cross, cross, gain + y * y * d_gain


@njit(**_JIT)
def straighten(cam, u, v):
    """Ideal point (x, y) of a raw px and the lens's derivatives there (before the intrinsics): Newton; NaN: no inverse."""
    by = (v - cam[16]) / cam[15]
    bx = (u - cam[14] - cam[13] * by) / cam[12]
    model = cam[47]
    if model == 0.0:
        return bx, by, 1.0, 0.0, 0.0, 1.0
    if model == 3.0:
        x, y = _straighten_fisheye(cam, bx, by)
        _, _, a, b, c, d = _bend_fisheye(cam, x, y)
        return x, y, a, b, c, d
    if model == 1.0:
        return _straighten_brown(cam, bx, by)
    w = 1.0 / (cam[44] * bx + cam[45] * by + cam[46])
    x, y, a, b, c, d = _straighten_brown(
        cam, (cam[38] * bx + cam[39] * by + cam[40]) * w, (cam[41] * bx + cam[42] * by + cam[43]) * w
    )
    gx, gy, _, _, _, _ = _bend_brown(cam, x, y)
    _, _, a, b, c, d = _tilt(cam, gx, gy, a, b, c, d)
    return x, y, a, b, c, d


@njit(**_JIT)
def _straighten_brown(cam, bx, by):
    r2 = bx * bx + by * by
    over = 1.0 + r2 * (cam[17] + r2 * (cam[18] + r2 * cam[21]))
    under = 1.0 + r2 * (cam[22] + r2 * (cam[23] + r2 * cam[24]))
    # the radial part undone at the bent radius; where that makes no sense, the bent point itself
    gain = under / over if over > 0.3 * under else 1.0
    x, y = bx * gain, by * gain
    a, b, c, d = 1.0, 0.0, 0.0, 1.0
    for _ in range(30):
        gx, gy, a, b, c, d = _bend_brown(cam, x, y)
        det = a * d - b * c
        # past the fold of the model the determinant changes sign: there is no inverse beyond it
        if not det > 0.0:
            return math.nan, math.nan, a, b, c, d
        ex, ey = gx - bx, gy - by
        over = 1.0 / det
        dx, dy = (d * ex - b * ey) * over, (a * ey - c * ex) * over
        x, y = x - dx, y - dy
        # Newton squares the error: what is left after this step is below 1e-13, and the derivatives hold
        if dx * dx + dy * dy < 1e-13:
            return x, y, a, b, c, d
    return math.nan, math.nan, a, b, c, d


@njit(**_JIT)
def _straighten_fisheye(cam, bx, by):
    bent = math.sqrt(bx * bx + by * by)
    angle = min(bent, 0.5 * math.pi)
    for _ in range(30):
        a2 = angle * angle
        value = angle * (1.0 + a2 * (cam[17] + a2 * (cam[18] + a2 * (cam[19] + a2 * cam[20])))) - bent
        slope = 1.0 + a2 * (3.0 * cam[17] + a2 * (5.0 * cam[18] + a2 * (7.0 * cam[19] + a2 * 9.0 * cam[20])))
        if not slope > 0.0:
            return math.nan, math.nan
        step = value / slope
        angle -= step
        if step * step < 1e-18:
            break
    else:
        return math.nan, math.nan
    if not 0.0 <= angle < 0.5 * math.pi:
        return math.nan, math.nan
    scale = math.tan(angle) / bent if bent > 1e-12 else 1.0
    return bx * scale, by * scale


@njit(**_JIT)
def _straighten_brown_row(cam, xy, out, last):
    """`straighten` of one camera's K px (K, 2) into out (6, K), three Newton steps side by side; last (K,) squared steps."""
    cx, cy, skew, ifx, ify = cam[14], cam[16], cam[13], 1.0 / cam[12], 1.0 / cam[15]
    k1, k2, p1, p2, k3, k4 = cam[17], cam[18], cam[19], cam[20], cam[21], cam[22]
    k5, k6, s1, s2, s3, s4 = cam[23], cam[24], cam[25], cam[26], cam[27], cam[28]
    count = len(xy)
    for k in range(count):
        by = (xy[k, 1] - cy) * ify
        bx = (xy[k, 0] - cx - skew * by) * ifx
        r2 = bx * bx + by * by
        over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        under = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
        gain = under / over if over > 0.3 * under else 1.0
        out[0, k], out[1, k] = bx * gain, by * gain
    for _ in range(3):
        for k in range(count):
            by = (xy[k, 1] - cy) * ify
            bx = (xy[k, 0] - cx - skew * by) * ifx
            gx, gy, a, b, c, d = _brown(out[0, k], out[1, k], k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4)
            det = a * d - b * c
            ex, ey = gx - bx, gy - by
            over = 1.0 / det
            dx, dy = (d * ex - b * ey) * over, (a * ey - c * ex) * over
            out[0, k] -= dx
            out[1, k] -= dy
            out[2, k], out[3, k], out[4, k], out[5, k] = a, b, c, d
            last[k] = dx * dx + dy * dy if det > 0.0 else math.inf


@njit(**_JIT)
def straighten_group(cams, xy_img, ideal, last):
    """`straighten` of every view of a group, xy_img (C, K, 2), into ideal (C, 6, K). last (K,) is scratch."""
    for c in range(len(cams)):
        by_row = cams[c, 47] == 1.0
        if by_row:
            _straighten_brown_row(cams[c], xy_img[c], ideal[c], last)
        for k in range(xy_img.shape[1]):
            # few need more than three steps; those that have no inverse are told by the full search
            if by_row and last[k] < 1e-13:
                continue
            u, v = xy_img[c, k, 0], xy_img[c, k, 1]
            if not (math.isfinite(u) and math.isfinite(v)):
                ideal[c, 0, k] = math.nan
                continue
            x, y, a, b, cc, d = straighten(cams[c], u, v)
            ideal[c, 0, k], ideal[c, 1, k], ideal[c, 2, k] = x, y, a
            ideal[c, 3, k], ideal[c, 4, k], ideal[c, 5, k] = b, cc, d


@njit(**_JIT)
def look(cams, c, ideal, k, sigma, views, n):
    """Fill row n of `views`: ideal x, y, the whitening matrix (4), camera index. False when the view is unusable."""
    x, y = ideal[c, 0, k], ideal[c, 1, k]
    if not (sigma > 0.0 and math.isfinite(sigma) and math.isfinite(x) and math.isfinite(y)):
        return False
    certain = 1.0 / sigma
    fx, skew, fy = cams[c, 12] * certain, cams[c, 13] * certain, cams[c, 15] * certain
    views[n, 0], views[n, 1], views[n, 6] = x, y, c
    views[n, 2] = fx * ideal[c, 2, k] + skew * ideal[c, 4, k]
    views[n, 3] = fx * ideal[c, 3, k] + skew * ideal[c, 5, k]
    views[n, 4], views[n, 5] = fy * ideal[c, 4, k], fy * ideal[c, 5, k]
    return True


@njit(**_JIT)
def squared_residual(cams, views, i, p):
    """|e|^2 of a world point in view i; infinity behind the camera."""
    c = int(views[i, 6])
    z = cams[c, 6] * p[0] + cams[c, 7] * p[1] + cams[c, 8] * p[2] + cams[c, 11]
    if not z > 1e-6:
        return math.inf
    iz = 1.0 / z
    rx = (cams[c, 0] * p[0] + cams[c, 1] * p[1] + cams[c, 2] * p[2] + cams[c, 9]) * iz - views[i, 0]
    ry = (cams[c, 3] * p[0] + cams[c, 4] * p[1] + cams[c, 5] * p[2] + cams[c, 10]) * iz - views[i, 1]
    e0, e1 = views[i, 2] * rx + views[i, 3] * ry, views[i, 4] * rx + views[i, 5] * ry
    return e0 * e0 + e1 * e1


@njit(**_JIT)
def loss(s):
    """The robust loss of a squared whitened residual."""
    return s if s < KNEE else 2.0 * KNEE - KNEE * KNEE / s


@njit(**_JIT)
def normal_system(cams, views, n, p, system):
    """Robust normal equations at p: system[:6] upper information, [6:9] half the loss's gradient; returns the loss."""
    h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = total = 0.0
    for i in range(n):
        c = int(views[i, 6])
        r6, r7, r8 = cams[c, 6], cams[c, 7], cams[c, 8]
        z = r6 * p[0] + r7 * p[1] + r8 * p[2] + cams[c, 11]
        if not z > 1e-6:
            total += 2.0 * KNEE
            continue
        iz = 1.0 / z
        x = (cams[c, 0] * p[0] + cams[c, 1] * p[1] + cams[c, 2] * p[2] + cams[c, 9]) * iz
        y = (cams[c, 3] * p[0] + cams[c, 4] * p[1] + cams[c, 5] * p[2] + cams[c, 10]) * iz
        w0, w1, w2, w3 = views[i, 2], views[i, 3], views[i, 4], views[i, 5]
        rx, ry = x - views[i, 0], y - views[i, 1]
        e0, e1 = w0 * rx + w1 * ry, w2 * rx + w3 * ry
        s = e0 * e0 + e1 * e1
        weight = 1.0 if s < KNEE else (KNEE / s) ** 2
        total += loss(s)
        jx0, jx1, jx2 = (cams[c, 0] - x * r6) * iz, (cams[c, 1] - x * r7) * iz, (cams[c, 2] - x * r8) * iz
        jy0, jy1, jy2 = (cams[c, 3] - y * r6) * iz, (cams[c, 4] - y * r7) * iz, (cams[c, 5] - y * r8) * iz
        a0, a1, a2 = w0 * jx0 + w1 * jy0, w0 * jx1 + w1 * jy1, w0 * jx2 + w1 * jy2
        b0, b1, b2 = w2 * jx0 + w3 * jy0, w2 * jx1 + w3 * jy1, w2 * jx2 + w3 * jy2
        h00 += weight * (a0 * a0 + b0 * b0)
        h01 += weight * (a0 * a1 + b0 * b1)
        h02 += weight * (a0 * a2 + b0 * b2)
        h11 += weight * (a1 * a1 + b1 * b1)
        h12 += weight * (a1 * a2 + b1 * b2)
        h22 += weight * (a2 * a2 + b2 * b2)
        g0 += weight * (a0 * e0 + b0 * e1)
        g1 += weight * (a1 * e0 + b1 * e1)
        g2 += weight * (a2 * e0 + b2 * e1)
    system[0], system[1], system[2], system[3], system[4], system[5] = h00, h01, h02, h11, h12, h22
    system[6], system[7], system[8] = g0, g1, g2
    return total


@njit(**_JIT)
def solve3(system, damping, out):
    """out = -(H + damping diag H)^-1 g by Cholesky; False when H is not positive definite."""
    grow = 1.0 + damping
    h00 = system[0] * grow
    if not h00 > 0.0:
        return False
    l00 = math.sqrt(h00)
    l10, l20 = system[1] / l00, system[2] / l00
    h11 = system[3] * grow - l10 * l10
    if not h11 > 0.0:
        return False
    l11 = math.sqrt(h11)
    l21 = (system[4] - l20 * l10) / l11
    h22 = system[5] * grow - l20 * l20 - l21 * l21
    if not h22 > 0.0:
        return False
    l22 = math.sqrt(h22)
    y0 = -system[6] / l00
    y1 = (-system[7] - l10 * y0) / l11
    y2 = (-system[8] - l20 * y0 - l21 * y1) / l22
    out[2] = y2 / l22
    out[1] = (y1 - l21 * out[2]) / l11
    out[0] = (y0 - l10 * out[1] - l20 * out[2]) / l00
    return True


@njit(**_JIT)
def refine(cams, views, n, p, work):
    """Levenberg-Marquardt on the robust loss from p, in place; returns the loss. work: (3, 9)."""
    here, there, step, ahead = work[0], work[1], work[2, :3], work[2, 3:]
    best = normal_system(cams, views, n, p, here)
    damping = 0.0
    for _ in range(20):
        if not solve3(here, damping, step):
            damping = max(1e-6, 10.0 * damping)
            if damping > 1e3:
                break
            continue
        for i in range(3):
            ahead[i] = p[i] + step[i]
        loss_there = normal_system(cams, views, n, ahead, there)
        gain = -(step[0] * here[6] + step[1] * here[7] + step[2] * here[8])
        if loss_there <= best:
            for i in range(3):
                p[i] = ahead[i]
            here, there = there, here
            best = loss_there
            damping *= 0.1
            if damping < 1e-7:
                damping = 0.0
        else:
            damping = max(1e-3, 10.0 * damping)
        # the step that is left, in standard deviations of the point
        if gain < 1e-8:
            break
    return best


@njit(**_JIT)
def _add_row(system, weight, a0, a1, a2, e):
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


@njit(**_JIT)
def _depth_rows(cams, views, i):
    """Depth-scaled residuals of view i as rows: (x m3 - m1) . (p, 1) and (y m3 - m2) . (p, 1) in ideal coordinates."""
    c, x, y = int(views[i, 6]), views[i, 0], views[i, 1]
    r6, r7, r8, r11 = cams[c, 6], cams[c, 7], cams[c, 8], cams[c, 11]
    return (
        x * r6 - cams[c, 0],
        x * r7 - cams[c, 1],
        x * r8 - cams[c, 2],
        x * r11 - cams[c, 9],
        y * r6 - cams[c, 3],
        y * r7 - cams[c, 4],
        y * r8 - cams[c, 5],
        y * r11 - cams[c, 10],
    )


@njit(**_JIT)
def linear_start(cams, views, n, p, system):
    """Depth-scaled whitened linear least squares over all views into p; False when the rays do not define a point."""
    for i in range(9):
        system[i] = 0.0
    for i in range(n):
        a0, a1, a2, a3, b0, b1, b2, b3 = _depth_rows(cams, views, i)
        w0, w1, w2, w3 = views[i, 2], views[i, 3], views[i, 4], views[i, 5]
        _add_row(system, 1.0, w0 * a0 + w1 * b0, w0 * a1 + w1 * b1, w0 * a2 + w1 * b2, w0 * a3 + w1 * b3)
        _add_row(system, 1.0, w2 * a0 + w3 * b0, w2 * a1 + w3 * b1, w2 * a2 + w3 * b2, w2 * a3 + w3 * b3)
    return solve3(system, 0.0, p)


@njit(**_JIT)
def pair_point(cams, views, i, j, p):
    """Point nearest to two rays into p (their common perpendicular's middle); False for parallel rays."""
    one, two = views[i], views[j]
    cam, other = cams[int(one[6])], cams[int(two[6])]
    d0 = cam[0] * one[0] + cam[3] * one[1] + cam[6]
    d1 = cam[1] * one[0] + cam[4] * one[1] + cam[7]
    d2 = cam[2] * one[0] + cam[5] * one[1] + cam[8]
    f0 = other[0] * two[0] + other[3] * two[1] + other[6]
    f1 = other[1] * two[0] + other[4] * two[1] + other[7]
    f2 = other[2] * two[0] + other[5] * two[1] + other[8]
    b0, b1, b2 = other[48] - cam[48], other[49] - cam[49], other[50] - cam[50]
    dd, ff, df = d0 * d0 + d1 * d1 + d2 * d2, f0 * f0 + f1 * f1 + f2 * f2, d0 * f0 + d1 * f1 + d2 * f2
    det = dd * ff - df * df
    if not det > 1e-6 * dd * ff:
        return False
    bd, bf = b0 * d0 + b1 * d1 + b2 * d2, b0 * f0 + b1 * f1 + b2 * f2
    s, t = (bd * ff - bf * df) / det, (bd * df - bf * dd) / det
    p[0] = 0.5 * (cam[48] + s * d0 + other[48] + t * f0)
    p[1] = 0.5 * (cam[49] + s * d1 + other[49] + t * f1)
    p[2] = 0.5 * (cam[50] + s * d2 + other[50] + t * f2)
    return True


@njit(**_JIT)
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


@njit(**_JIT)
def robust_point(cams, views, n, p, other, work):
    """Minimum of the robust loss over n >= 2 views into p; returns the loss, infinity when the rays define no point."""
    best = math.inf
    if linear_start(cams, views, n, p, work[0]):
        best = refine(cams, views, n, p, work)
        worst = 0.0
        for i in range(n):
            worst = max(worst, squared_residual(cams, views, i, p))
        if worst < GATE:
            return best
    if n > 2 and consensus(cams, views, n, other, work[2]) < math.inf:
        found = refine(cams, views, n, other, work)
        if found < best:
            p[:] = other
            best = found
    return best


@njit(**_JIT)
def invert(system, cov):
    """cov = inverse of the information in system[:6]; False when the rays are one ray."""
    a, b, c, d, e, f = system[0], system[1], system[2], system[3], system[4], system[5]
    m00, m01, m02 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * m00 + b * m01 + c * m02
    mean = (a + d + f) / 3.0
    if not det > RANK * mean * mean * mean:
        return False
    cov[0, 0], cov[0, 1], cov[0, 2] = m00 / det, m01 / det, m02 / det
    cov[1, 1], cov[1, 2], cov[2, 2] = (a * f - c * c) / det, (b * c - a * e) / det, (a * d - b * b) / det
    cov[1, 0], cov[2, 0], cov[2, 1] = cov[0, 1], cov[0, 2], cov[1, 2]
    return True


@njit(**_JIT)
def squared_px(cams, c, u, v, p):
    """Squared raw-pixel distance between what camera c saw and the reprojection through its lens."""
    cam = cams[c]
    iz = 1.0 / (cam[6] * p[0] + cam[7] * p[1] + cam[8] * p[2] + cam[11])
    x = (cam[0] * p[0] + cam[1] * p[1] + cam[2] * p[2] + cam[9]) * iz
    y = (cam[3] * p[0] + cam[4] * p[1] + cam[5] * p[2] + cam[10]) * iz
    found_u, found_v, _, _, _, _ = bend(cam, x, y)
    return (found_u - u) ** 2 + (found_v - v) ** 2


@njit(**_JIT)
def gather(cams, ideal, sigma, scale, k, views):
    """Usable views of keypoint k into the first rows of `views`; returns how many."""
    n = 0
    for c in range(len(cams)):
        if look(cams, c, ideal, k, sigma[c, k] * scale, views, n):
            n += 1
    return n


@njit(**_JIT)
def middle_residual(squares, n):
    """Middle one of n squared residuals (sorted in place), in units of what it is when the stated sigma is right.

    At least the third: any two rays nearly meet, so the two smallest say little. Unlike a sum it stays among the good
    views when half of eight are wrong.
    """
    for i in range(1, n):
        value = squares[i]
        j = i
        while j > 0 and squares[j - 1] > value:
            squares[j] = squares[j - 1]
            j -= 1
        squares[j] = value
    middle = max(3, (n + 1) // 2)
    return squares[middle - 1] / (-2.0 * math.log(1.0 - middle / (n + 1.0)) * (1.0 - 1.5 / n))


@njit(**_JIT)
def inflate(cov, chi2, dof, floor):
    """Scale covariances (K, 3, 3) by how much larger the residuals are than the stated sigma explains.

    Shrunk twice: the group's ratio towards 1 (and never below `floor`), each keypoint's towards its group's.
    """
    group = max(floor, (PRIOR_DOF + chi2.sum()) / (PRIOR_DOF + dof.sum()))
    for k in range(len(cov)):
        scale = (PRIOR_DOF * group + chi2[k]) / (PRIOR_DOF + dof[k])
        for i in range(3):
            for j in range(3):
                cov[k, i, j] *= scale


@njit(**_JIT)
def finish_robust(cams, views, n, p, xy_img, k, work, cov):
    """Covariance and figures of a robust point: (n_used, rms px, chi2); n_used 0 when it is none."""
    used, chi2, px2 = 0, 0.0, 0.0
    for i in range(n):
        s = squared_residual(cams, views, i, p)
        if s < USED:
            chi2 += s
            c = int(views[i, 6])
            px2 += squared_px(cams, c, xy_img[c, k, 0], xy_img[c, k, 1], p)
            for j in range(7):
                views[used, j] = views[i, j]
            used += 1
    if used < 2:
        return 0, math.nan, 0.0
    normal_system(cams, views, used, p, work[0])
    if not invert(work[0], cov):
        return 0, math.nan, 0.0
    return used, math.sqrt(px2 / used), chi2


@njit(**_JIT)
def has_rival(cams, views, n, p, rest, q, other, work):
    """Whether the views that p leaves out agree on another point q in no smaller number: then nobody can tell."""
    left = 0
    for i in range(n):
        if not squared_residual(cams, views, i, p) < USED:
            for j in range(7):
                rest[left, j] = views[i, j]
            left += 1
    if left < 2 or 2 * left < n or robust_point(cams, rest, left, q, other, work) == math.inf:
        return False
    agree = 0
    for i in range(left):
        agree += squared_residual(cams, rest, i, q) < USED
    return agree >= 2 and agree >= n - left


@njit(**_JIT)
def solve_robust(cams, xy_img, sigma, most, xyz, cov, reproj, n_views, square, cost, rival, wanted):
    """Robust fusion of groups: xy_img (G, C, K, 2) raw px, sigma (G, C, K) px (not > 0: unusable), scaled by `most` at most.

    Filled in: xyz (G, K, 3), cov (G, K, 3, 3), reproj (G, K) px, n_views (G, K), square (G, C, K) = |e|^2 of every
    usable view, cost (G, K) = robust loss, rival (G, K) where as many views agree on another point, wanted (G,) the scale of
    sigma that the residuals ask for. Missing points are NaN with n_views 0.
    """
    groups, count, keypoints = sigma.shape
    views, rest, work, q = np.empty((count, 7)), np.empty((count, 7)), np.empty((3, 9)), np.empty(3)
    pool, squares, p, other = np.empty(keypoints), np.empty(count), np.empty(3), np.empty(3)
    chi2, dof = np.empty(keypoints), np.empty(keypoints)
    ideal, last = np.empty((count, 6, keypoints)), np.empty(keypoints)
    for g in range(groups):
        scale = 1.0
        straighten_group(cams, xy_img[g], ideal, last)
        for attempt in range(ATTEMPTS):
            many = 0
            chi2[:], dof[:] = 0.0, 0.0
            square[g], xyz[g], cov[g], reproj[g] = math.nan, math.nan, math.nan, math.nan
            n_views[g], cost[g], rival[g] = 0, 0.0, False
            for k in range(keypoints):
                n = gather(cams, ideal, sigma[g], scale, k, views)
                cost[g, k] = 2.0 * KNEE * n
                if n < 2 or robust_point(cams, views, n, p, other, work) == math.inf:
                    continue
                cost[g, k] = 0.0
                for i in range(n):
                    s = squared_residual(cams, views, i, p)
                    square[g, int(views[i, 6]), k] = s
                    cost[g, k] += loss(s)
                    squares[i] = s
                if n > 2:
                    pool[many] = middle_residual(squares, n)
                    many += 1
                rival[g, k] = has_rival(cams, views, n, p, rest, q, other, work)
                used, px, total = finish_robust(cams, views, n, p, xy_img[g], k, work, cov[g, k])
                if used == 0:
                    cov[g, k] = math.nan
                    continue
                xyz[g, k], reproj[g, k], n_views[g, k] = p, px, used
                chi2[k], dof[k] = total, 2.0 * used - 3.0
            ratio = np.median(pool[:many]) if many >= MIN_POINTS else 1.0
            better = max(MIN_SCALE, scale * math.sqrt(ratio))
            right = 1.0 / RESCALE < ratio < RESCALE or better == scale
            wanted[g] = scale if right else better
            if right or attempt == ATTEMPTS - 1 or not better < most:
                break
            scale = better
        inflate(cov[g], chi2, dof, 1.0 / (scale * scale))


@njit(**_JIT)
def linear_point(cams, views, weights, n, p, work, cov):
    """Weighted least squares of the paper's rows (u m3 - m1), (v m3 - m2) in undistorted px into p.

    Its covariance, by error propagation of the pixel noise, into cov. Returns the sum of squared whitened residuals and
    what it is expected to be: 2n - 3 for the best weights, more for others. NaN when the rays define no point.
    """
    system, spread, best = work[0], work[1], work[2]
    for i in range(9):
        system[i] = spread[i] = best[i] = 0.0
    for i in range(n):
        a0, a1, a2, a3, b0, b1, b2, b3 = _depth_rows(cams, views, i)
        c = int(views[i, 6])
        fx, skew, fy = cams[c, 12], cams[c, 13], cams[c, 15]
        w = weights[i]
        _add_row(system, w, fx * a0 + skew * b0, fx * a1 + skew * b1, fx * a2 + skew * b2, fx * a3 + skew * b3)
        _add_row(system, w, fy * b0, fy * b1, fy * b2, fy * b3)
    if not (solve3(system, 0.0, p) and invert(system, cov)):
        return math.nan, math.nan
    total = 0.0
    for i in range(n):
        a0, a1, a2, a3, b0, b1, b2, b3 = _depth_rows(cams, views, i)
        c = int(views[i, 6])
        fx, skew, fy = cams[c, 12], cams[c, 13], cams[c, 15]
        w0, w1, w2, w3 = views[i, 2], views[i, 3], views[i, 4], views[i, 5]
        depth = cams[c, 6] * p[0] + cams[c, 7] * p[1] + cams[c, 8] * p[2] + cams[c, 11]
        if not depth > 1e-6:
            return math.nan, math.nan
        iz = 1.0 / depth
        rx, ry = (a0 * p[0] + a1 * p[1] + a2 * p[2] + a3) * iz, (b0 * p[0] + b1 * p[1] + b2 * p[2] + b3) * iz
        total += (w0 * rx + w1 * ry) ** 2 + (w2 * rx + w3 * ry) ** 2
        _add_row(best, 1.0, (w0 * a0 + w1 * b0) * iz, (w0 * a1 + w1 * b1) * iz, (w0 * a2 + w1 * b2) * iz, 0.0)
        _add_row(best, 1.0, (w2 * a0 + w3 * b0) * iz, (w2 * a1 + w3 * b1) * iz, (w2 * a2 + w3 * b2) * iz, 0.0)
        # noise of the two rows: depth * K J^-1 * sigma, the inverse of the whitening matrix
        gain = weights[i] * depth / (w0 * w3 - w1 * w2)
        n0, n1 = (fx * w3 - skew * w2) * gain, (skew * w0 - fx * w1) * gain
        n2, n3 = -fy * w2 * gain, fy * w0 * gain
        u0, u1, u2 = fx * a0 + skew * b0, fx * a1 + skew * b1, fx * a2 + skew * b2
        _add_row(spread, 1.0, u0 * n0 + fy * b0 * n2, u1 * n0 + fy * b1 * n2, u2 * n0 + fy * b2 * n2, 0.0)
        _add_row(spread, 1.0, u0 * n1 + fy * b0 * n3, u1 * n1 + fy * b1 * n3, u2 * n1 + fy * b2 * n3, 0.0)
    return total, 2.0 * n - 6.0 + _sandwich(cov, spread, best)


@njit(**_JIT)
def _sandwich(cov, spread, information):
    """cov <- cov spread cov, the middle as six upper entries; returns the trace of information times that."""
    c00, c01, c02, c11, c12, c22 = cov[0, 0], cov[0, 1], cov[0, 2], cov[1, 1], cov[1, 2], cov[2, 2]
    for i in range(3):
        c0, c1, c2 = (c00, c01, c02) if i == 0 else ((c01, c11, c12) if i == 1 else (c02, c12, c22))
        h0 = c0 * spread[0] + c1 * spread[1] + c2 * spread[2]
        h1 = c0 * spread[1] + c1 * spread[3] + c2 * spread[4]
        h2 = c0 * spread[2] + c1 * spread[4] + c2 * spread[5]
        cov[i, 0] = h0 * c00 + h1 * c01 + h2 * c02
        cov[i, 1] = h0 * c01 + h1 * c11 + h2 * c12
        cov[i, 2] = h0 * c02 + h1 * c12 + h2 * c22
    diagonal = information[0] * cov[0, 0] + information[3] * cov[1, 1] + information[5] * cov[2, 2]
    return diagonal + 2.0 * (information[1] * cov[0, 1] + information[2] * cov[0, 2] + information[4] * cov[1, 2])


@njit(**_JIT)
def solve_linear(cams, xy_img, sigma, weight, xyz, cov, reproj, n_views):
    """Paper's weighted least squares of groups: weight (G, C, K), 0 leaves a view out; the rest as in `solve_robust`."""
    groups, count, keypoints = sigma.shape
    views, work, weights = np.empty((count, 7)), np.empty((3, 9)), np.empty(count)
    chi2, dof = np.empty(keypoints), np.empty(keypoints)
    ideal, last, p = np.empty((count, 6, keypoints)), np.empty(keypoints), np.empty(3)
    for g in range(groups):
        straighten_group(cams, xy_img[g], ideal, last)
        chi2[:], dof[:] = 0.0, 0.0
        xyz[g], cov[g], reproj[g], n_views[g] = math.nan, math.nan, math.nan, 0
        for k in range(keypoints):
            n = 0
            for c in range(count):
                if weight[g, c, k] > 0.0 and look(cams, c, ideal, k, sigma[g, c, k], views, n):
                    weights[n] = weight[g, c, k]
                    n += 1
            if n < 2:
                continue
            total, expected = linear_point(cams, views, weights, n, p, work, cov[g, k])
            if not math.isfinite(total):
                cov[g, k] = math.nan
                continue
            px2 = 0.0
            for i in range(n):
                c = int(views[i, 6])
                px2 += squared_px(cams, c, xy_img[g, c, k, 0], xy_img[g, c, k, 1], p)
            xyz[g, k, 0], xyz[g, k, 1], xyz[g, k, 2] = p[0], p[1], p[2]
            reproj[g, k], n_views[g, k] = math.sqrt(px2 / n), n
            chi2[k], dof[k] = total, expected
        inflate(cov[g], chi2, dof, 1.0)


@njit(**_JIT)
def squares_of(cams, xy_img, sigma, xyz, square):
    """square (G, C, K) = |e|^2 of the views of given points xyz (G, K, 3); NaN where either is missing."""
    groups, count, keypoints = sigma.shape
    views = np.empty((1, 7))
    ideal, last = np.empty((count, 6, keypoints)), np.empty(keypoints)
    square[:] = math.nan
    for g in range(groups):
        straighten_group(cams, xy_img[g], ideal, last)
        for c in range(count):
            for k in range(keypoints):
                if math.isfinite(xyz[g, k, 0]) and look(cams, c, ideal, k, sigma[g, c, k], views, 0):
                    square[g, c, k] = squared_residual(cams, views, 0, xyz[g, k])
