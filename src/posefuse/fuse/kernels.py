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

KNEE = 6.0  # 95 % of a 2D Gaussian
GATE = 13.8  # 99.9 %: all views within it need no consensus search
USED = 19.0  # weight (KNEE / s)^2 of 0.1: beyond it a view no longer counts as used
RANK = 1e-10  # smallest over largest eigenvalue of the information below which the rays are one ray
PRIOR_DOF = 8.0  # how many residuals the stated sigma is worth when residuals contradict it
RESCALE = 2.0  # squared ratio of seen to stated noise from which the stated sigma is taken as wrong
MIN_POINTS = 5  # of three or more views, to judge the stated sigma by
MAX_TRIALS = 120
ATTEMPTS = 5
MAX_SCALE = 10.0  # beyond it the views are taken to be wrong rather than the stated sigma

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
    k1, k2, p1, p2, k3, k4 = cam[17], cam[18], cam[19], cam[20], cam[21], cam[22]
    k5, k6, s1, s2, s3, s4 = cam[23], cam[24], cam[25], cam[26], cam[27], cam[28]
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
    """Ideal point of a raw px: Newton on the exact lens; NaN where the lens has no inverse."""
    by = (v - cam[16]) / cam[15]
    bx = (u - cam[14] - cam[13] * by) / cam[12]
    model = cam[47]
    if model == 0.0:
        return bx, by
    if model == 3.0:
        return _straighten_fisheye(cam, bx, by)
    if model == 2.0:
        w = 1.0 / (cam[44] * bx + cam[45] * by + cam[46])
        bx, by = (cam[38] * bx + cam[39] * by + cam[40]) * w, (cam[41] * bx + cam[42] * by + cam[43]) * w
    x, y = bx, by
    for _ in range(30):
        gx, gy, a, b, c, d = _bend_brown(cam, x, y)
        det = a * d - b * c
        # past the fold of the model the determinant changes sign: there is no inverse beyond it
        if not det > 0.0:
            return math.nan, math.nan
        ex, ey = gx - bx, gy - by
        dx, dy = (d * ex - b * ey) / det, (a * ey - c * ex) / det
        x, y = x - dx, y - dy
        # Newton squares the error: a step this small leaves nothing a float64 could show
        if dx * dx + dy * dy < 1e-18:
            return x, y
    return math.nan, math.nan


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
def look(cams, c, xy_img, sigma, view):
    """Fill one row of `view`: ideal x, y, the whitening matrix (4), camera index. False when the view is unusable."""
    u, v = xy_img[0], xy_img[1]
    if not (sigma > 0.0 and math.isfinite(u) and math.isfinite(v) and math.isfinite(sigma)):
        return False
    cam = cams[c]
    x, y = straighten(cam, u, v)
    if not (math.isfinite(x) and math.isfinite(y)):
        return False
    _, _, a, b, cc, d = bend(cam, x, y)
    view[0], view[1], view[6] = x, y, c
    view[2], view[3], view[4], view[5] = a / sigma, b / sigma, cc / sigma, d / sigma
    return True


@njit(**_JIT)
def squared_residual(cams, view, px, py, pz):
    """|e|^2 of a world point in a view; infinity behind the camera."""
    cam = cams[int(view[6])]
    z = cam[6] * px + cam[7] * py + cam[8] * pz + cam[11]
    if not z > 1e-6:
        return math.inf
    rx = (cam[0] * px + cam[1] * py + cam[2] * pz + cam[9]) / z - view[0]
    ry = (cam[3] * px + cam[4] * py + cam[5] * pz + cam[10]) / z - view[1]
    e0, e1 = view[2] * rx + view[3] * ry, view[4] * rx + view[5] * ry
    return e0 * e0 + e1 * e1


@njit(**_JIT)
def loss(s):
    """The robust loss of a squared whitened residual."""
    return s if s < KNEE else 2.0 * KNEE - KNEE * KNEE / s


@njit(**_JIT)
def normal_system(cams, views, n, p, system):
    """Robust normal equations at p: system[:6] upper information, [6:9] gradient; returns the loss."""
    system[:] = 0.0
    total = 0.0
    for i in range(n):
        view = views[i]
        cam = cams[int(view[6])]
        z = cam[6] * p[0] + cam[7] * p[1] + cam[8] * p[2] + cam[11]
        if not z > 1e-6:
            total += 2.0 * KNEE
            continue
        iz = 1.0 / z
        x = (cam[0] * p[0] + cam[1] * p[1] + cam[2] * p[2] + cam[9]) * iz
        y = (cam[3] * p[0] + cam[4] * p[1] + cam[5] * p[2] + cam[10]) * iz
        rx, ry = x - view[0], y - view[1]
        e0, e1 = view[2] * rx + view[3] * ry, view[4] * rx + view[5] * ry
        s = e0 * e0 + e1 * e1
        weight = 1.0 if s < KNEE else (KNEE / s) ** 2
        total += loss(s)
        jx0, jx1, jx2 = (cam[0] - x * cam[6]) * iz, (cam[1] - x * cam[7]) * iz, (cam[2] - x * cam[8]) * iz
        jy0, jy1, jy2 = (cam[3] - y * cam[6]) * iz, (cam[4] - y * cam[7]) * iz, (cam[5] - y * cam[8]) * iz
        a0, a1, a2 = view[2] * jx0 + view[3] * jy0, view[2] * jx1 + view[3] * jy1, view[2] * jx2 + view[3] * jy2
        b0, b1, b2 = view[4] * jx0 + view[5] * jy0, view[4] * jx1 + view[5] * jy1, view[4] * jx2 + view[5] * jy2
        system[0] += weight * (a0 * a0 + b0 * b0)
        system[1] += weight * (a0 * a1 + b0 * b1)
        system[2] += weight * (a0 * a2 + b0 * b2)
        system[3] += weight * (a1 * a1 + b1 * b1)
        system[4] += weight * (a1 * a2 + b1 * b2)
        system[5] += weight * (a2 * a2 + b2 * b2)
        system[6] += weight * (a0 * e0 + b0 * e1)
        system[7] += weight * (a1 * e0 + b1 * e1)
        system[8] += weight * (a2 * e0 + b2 * e1)
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
    here, there, step = work[0], work[1], work[2]
    best = normal_system(cams, views, n, p, here)
    damping = 0.0
    for _ in range(20):
        if not solve3(here, damping, step):
            damping = max(1e-6, 10.0 * damping)
            if damping > 1e3:
                break
            continue
        for i in range(3):
            step[3 + i] = p[i] + step[i]
        loss_there = normal_system(cams, views, n, step[3:6], there)
        gain = -(step[0] * here[6] + step[1] * here[7] + step[2] * here[8])
        if loss_there <= best:
            p[:] = step[3:6]
            here[:] = there
            best = loss_there
            damping *= 0.1
            if damping < 1e-7:
                damping = 0.0
        else:
            damping = max(1e-3, 10.0 * damping)
        # the step that is left, in standard deviations of the point
        if gain < 1e-9:
            break
    return best


@njit(**_JIT)
def linear_start(cams, views, n, p, system):
    """Depth-scaled linear least squares over all views into p; False when the rays do not define a point."""
    system[:] = 0.0
    for i in range(n):
        view = views[i]
        cam = cams[int(view[6])]
        for row in range(2):
            wx, wy = view[2 + 2 * row], view[3 + 2 * row]
            g = wx * view[0] + wy * view[1]
            a0 = g * cam[6] - wx * cam[0] - wy * cam[3]
            a1 = g * cam[7] - wx * cam[1] - wy * cam[4]
            a2 = g * cam[8] - wx * cam[2] - wy * cam[5]
            e = g * cam[11] - wx * cam[9] - wy * cam[10]
            system[0] += a0 * a0
            system[1] += a0 * a1
            system[2] += a0 * a2
            system[3] += a1 * a1
            system[4] += a1 * a2
            system[5] += a2 * a2
            system[6] += a0 * e
            system[7] += a1 * e
            system[8] += a2 * e
    return solve3(system, 0.0, p)


@njit(**_JIT)
def pair_point(cams, one, two, p):
    """Point nearest to two rays into p (their common perpendicular's middle); False for parallel rays."""
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
            if not pair_point(cams, views[i], views[(i + stride) % n], trial):
                continue
            total, inliers = 0.0, 0
            for j in range(n):
                s = squared_residual(cams, views[j], trial[0], trial[1], trial[2])
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
            worst = max(worst, squared_residual(cams, views[i], p[0], p[1], p[2]))
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
def squared_px(cams, view, xy_img, p):
    """Squared raw-pixel distance between what was seen and the reprojection through the lens."""
    cam = cams[int(view[6])]
    z = cam[6] * p[0] + cam[7] * p[1] + cam[8] * p[2] + cam[11]
    x = (cam[0] * p[0] + cam[1] * p[1] + cam[2] * p[2] + cam[9]) / z
    y = (cam[3] * p[0] + cam[4] * p[1] + cam[5] * p[2] + cam[10]) / z
    u, v, _, _, _, _ = bend(cam, x, y)
    return (u - xy_img[0]) ** 2 + (v - xy_img[1]) ** 2


@njit(**_JIT)
def gather(cams, xy_img, sigma, scale, k, views):
    """Usable views of keypoint k into the first rows of `views`; returns how many."""
    n = 0
    for c in range(len(cams)):
        if look(cams, c, xy_img[c, k], sigma[c, k] * scale, views[n]):
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
        cov[k] *= (PRIOR_DOF * group + chi2[k]) / (PRIOR_DOF + dof[k])


@njit(**_JIT)
def finish_robust(cams, views, n, p, xy_img, k, work, cov):
    """Covariance and figures of a robust point: (n_used, rms px, chi2); n_used 0 when it is none."""
    used, chi2, px2 = 0, 0.0, 0.0
    for i in range(n):
        s = squared_residual(cams, views[i], p[0], p[1], p[2])
        if s < USED:
            chi2 += s
            px2 += squared_px(cams, views[i], xy_img[int(views[i, 6]), k], p)
            views[used] = views[i]
            used += 1
    if used < 2:
        return 0, math.nan, 0.0
    normal_system(cams, views, used, p, work[0])
    if not invert(work[0], cov):
        return 0, math.nan, 0.0
    return used, math.sqrt(px2 / used), chi2


@njit(**_JIT)
def solve_robust(cams, xy_img, sigma, xyz, cov, reproj, n_views, square, cost):
    """Robust fusion of groups: xy_img (G, C, K, 2) raw px, sigma (G, C, K) px (not > 0: unusable).

    Filled in: xyz (G, K, 3), cov (G, K, 3, 3), reproj (G, K) px, n_views (G, K), square (G, C, K) = |e|^2 of every
    usable view, cost (G, K) = robust loss. Missing points are NaN with n_views 0.
    """
    groups, count, keypoints = sigma.shape
    views, work = np.empty((count, 7)), np.empty((3, 9))
    pool, squares, p, other = np.empty(keypoints), np.empty(count), np.empty(3), np.empty(3)
    chi2, dof = np.empty(keypoints), np.empty(keypoints)
    for g in range(groups):
        scale = 1.0
        for attempt in range(ATTEMPTS):
            many = 0
            chi2[:], dof[:] = 0.0, 0.0
            square[g], xyz[g], cov[g], reproj[g] = math.nan, math.nan, math.nan, math.nan
            n_views[g], cost[g] = 0, 0.0
            for k in range(keypoints):
                n = gather(cams, xy_img[g], sigma[g], scale, k, views)
                cost[g, k] = 2.0 * KNEE * n
                if n < 2 or robust_point(cams, views, n, p, other, work) == math.inf:
                    continue
                cost[g, k] = 0.0
                for i in range(n):
                    s = squared_residual(cams, views[i], p[0], p[1], p[2])
                    square[g, int(views[i, 6]), k] = s
                    cost[g, k] += loss(s)
                    squares[i] = s
                if n > 2:
                    pool[many] = middle_residual(squares, n)
                    many += 1
                used, px, total = finish_robust(cams, views, n, p, xy_img[g], k, work, cov[g, k])
                if used == 0:
                    cov[g, k] = math.nan
                    continue
                xyz[g, k], reproj[g, k], n_views[g, k] = p, px, used
                chi2[k], dof[k] = total, 2.0 * used - 3.0
            ratio = np.median(pool[:many]) if many >= MIN_POINTS else 1.0
            wider = scale * math.sqrt(ratio)
            if ratio < RESCALE or attempt == ATTEMPTS - 1 or not wider < MAX_SCALE:
                break
            scale = wider
        inflate(cov[g], chi2, dof, 1.0 / (scale * scale))


@njit(**_JIT)
def algebraic_row(cam, view, row, out):
    """Row (u m3 - m1) or (v m3 - m2) of the paper's system in undistorted px: out[:3] . x = out[3]."""
    kx = cam[12] if row == 0 else 0.0
    ky = cam[13] if row == 0 else cam[15]
    g = kx * view[0] + ky * view[1]
    for i in range(3):
        out[i] = g * cam[6 + i] - kx * cam[i] - ky * cam[3 + i]
    out[3] = kx * cam[9] + ky * cam[10] - g * cam[11]


@njit(**_JIT)
def linear_point(cams, views, weights, n, p, work, cov):
    """Weighted least squares of the algebraic rows into p, its covariance by error propagation into cov.

    Returns what the sum of squared whitened residuals is expected to be (2n - 3 for the best weights, more for others),
    or NaN when the rays define no point.
    """
    system, row, other = work[0], work[1], work[2]
    system[:] = 0.0
    for i in range(n):
        for r in range(2):
            algebraic_row(cams[int(views[i, 6])], views[i], r, row)
            m = 0
            for j in range(3):
                for jj in range(j, 3):
                    system[m] += weights[i] * row[j] * row[jj]
                    m += 1
                system[6 + j] -= weights[i] * row[j] * row[3]
    if not (solve3(system, 0.0, p) and invert(system, cov)):
        return math.nan
    # noise of the two rows of a view: depth * K J^-1 * sigma, the inverse of its whitening matrix
    middle, information = np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(n):
        view = views[i]
        cam = cams[int(view[6])]
        depth = cam[6] * p[0] + cam[7] * p[1] + cam[8] * p[2] + cam[11]
        det = (view[2] * view[5] - view[3] * view[4]) / (weights[i] * depth)
        a, b, c, d = view[5] / det, -view[3] / det, -view[4] / det, view[2] / det
        algebraic_row(cam, view, 0, row)
        algebraic_row(cam, view, 1, other)
        nu0, nu1 = cam[12] * a + cam[13] * c, cam[12] * b + cam[13] * d
        nv0, nv1 = cam[15] * c, cam[15] * d
        for j in range(3):
            t0, t1 = row[j] * nu0 + other[j] * nv0, row[j] * nu1 + other[j] * nv1
            ex, ey = (view[0] * cam[6 + j] - cam[j]) / depth, (view[1] * cam[6 + j] - cam[3 + j]) / depth
            e0, e1 = view[2] * ex + view[3] * ey, view[4] * ex + view[5] * ey
            for jj in range(3):
                middle[j, jj] += t0 * (row[jj] * nu0 + other[jj] * nv0) + t1 * (row[jj] * nu1 + other[jj] * nv1)
                fx, fy = (view[0] * cam[6 + jj] - cam[jj]) / depth, (view[1] * cam[6 + jj] - cam[3 + jj]) / depth
                information[j, jj] += e0 * (view[2] * fx + view[3] * fy) + e1 * (view[4] * fx + view[5] * fy)
    cov[:] = cov @ middle @ cov
    expected = 2.0 * n - 6.0
    for j in range(3):
        for jj in range(3):
            expected += information[j, jj] * cov[j, jj]
    return expected


@njit(**_JIT)
def solve_linear(cams, xy_img, sigma, weight, xyz, cov, reproj, n_views):
    """Paper's weighted least squares of groups: weight (G, C, K), 0 leaves a view out; the rest as in `solve_robust`."""
    groups, count, keypoints = sigma.shape
    views, work, weights = np.empty((count, 7)), np.empty((3, 9)), np.empty(count)
    chi2, dof = np.empty(keypoints), np.empty(keypoints)
    xyz[:], cov[:], reproj[:], n_views[:] = math.nan, math.nan, math.nan, 0
    p = np.empty(3)
    for g in range(groups):
        chi2[:], dof[:] = 0.0, 0.0
        for k in range(keypoints):
            n = 0
            for c in range(count):
                if weight[g, c, k] > 0.0 and look(cams, c, xy_img[g, c, k], sigma[g, c, k], views[n]):
                    weights[n] = weight[g, c, k]
                    n += 1
            expected = linear_point(cams, views, weights, n, p, work, cov[g, k]) if n > 1 else math.nan
            total, px2 = 0.0 if math.isfinite(expected) else math.nan, 0.0
            for i in range(n):
                total += squared_residual(cams, views[i], p[0], p[1], p[2])
                px2 += squared_px(cams, views[i], xy_img[g, int(views[i, 6]), k], p)
            if not math.isfinite(total):
                cov[g, k] = math.nan
                continue
            xyz[g, k], reproj[g, k], n_views[g, k] = p, math.sqrt(px2 / n), n
            chi2[k], dof[k] = total, expected
        inflate(cov[g], chi2, dof, 1.0)


@njit(**_JIT)
def squares_of(cams, xy_img, sigma, xyz, square):
    """square (G, C, K) = |e|^2 of the views of given points xyz (G, K, 3); NaN where either is missing."""
    groups, count, keypoints = sigma.shape
    view = np.empty(7)
    square[:] = math.nan
    for g in range(groups):
        for c in range(count):
            for k in range(keypoints):
                p = xyz[g, k]
                if math.isfinite(p[0]) and look(cams, c, xy_img[g, c, k], sigma[g, c, k], view):
                    square[g, c, k] = squared_residual(cams, view, p[0], p[1], p[2])
