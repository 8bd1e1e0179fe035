"""One point, many views: whitened residuals, robust loss, damped Gauss-Newton.

Residuals are whitened: e = J (x_projected - x_seen) / sigma in ideal image-plane coordinates, J = d(raw px)/d(ideal),
so |e|^2 is the squared pixel error in units of its variance and cameras of any lens and resolution add up.

Robust loss of s = |e|^2: s up to `KNEE`, then 2 KNEE - KNEE^2 / s: quadratic where noise lives (efficient, so the
inverse information is the covariance) and bounded like Geman-McClure where outliers live (a wrong view cannot pull).

Depth is one more row per view, (z - depth) / sigma along the optical axis, under the same loss: `planes` (n, 2) holds depth and
1 / sigma of each row of `views`, 0 where there is none. Without depth it is None: numba then compiles kernels in which none of
it is left.
"""

from __future__ import annotations

import math

from .cameras import R00, R01, R02, R10, R11, R12, R20, R21, R22, TX, TY, TZ, fast_kernel

KNEE = 9.0  # 98.9 % of a 2D Gaussian
RANK = 1e-10  # smallest over largest eigenvalue of the information below which the rays are one ray


@fast_kernel()
def look(ideal, white, scale, c, views, n):
    """Fill row n of `views`: ideal x, y, the whitening matrix (4), camera index. False when the view is unusable.

    ideal (2,) and white (2, 2) of camera c, NaN where unusable. scale: what the stated sigma is multiplied by.
    """
    if not (math.isfinite(ideal[0]) and math.isfinite(ideal[1]) and math.isfinite(white[0, 0])):
        return False
    certain = 1.0 / scale
    views[n, 0], views[n, 1], views[n, 6] = ideal[0], ideal[1], c
    views[n, 2], views[n, 3] = white[0, 0] * certain, white[0, 1] * certain
    views[n, 4], views[n, 5] = white[1, 0] * certain, white[1, 1] * certain
    return True


@fast_kernel()
def squared_residual(cams, views, i, p):
    """|e|^2 of a world point in view i; infinity behind the camera."""
    c = int(views[i, 6])
    z = cams[c, R20] * p[0] + cams[c, R21] * p[1] + cams[c, R22] * p[2] + cams[c, TZ]
    if not z > 1e-6:
        return math.inf
    iz = 1.0 / z
    rx = (cams[c, R00] * p[0] + cams[c, R01] * p[1] + cams[c, R02] * p[2] + cams[c, TX]) * iz - views[i, 0]
    ry = (cams[c, R10] * p[0] + cams[c, R11] * p[1] + cams[c, R12] * p[2] + cams[c, TY]) * iz - views[i, 1]
    e0, e1 = views[i, 2] * rx + views[i, 3] * ry, views[i, 4] * rx + views[i, 5] * ry
    return e0 * e0 + e1 * e1


@fast_kernel()
def squared_depth(cams, views, i, p, planes):
    """Squared whitened residual of a world point in the depth of view i; 0 where it has none."""
    c = int(views[i, 6])
    z = cams[c, R20] * p[0] + cams[c, R21] * p[1] + cams[c, R22] * p[2] + cams[c, TZ]
    return ((z - planes[i, 0]) * planes[i, 1]) ** 2


@fast_kernel()
def loss(s):
    """The robust loss of a squared whitened residual."""
    return s if s < KNEE else 2.0 * KNEE - KNEE * KNEE / s


@fast_kernel()
def normal_system(cams, views, n, p, system, planes=None):
    """Robust normal equations at p: system[:6] upper information, [6:9] half the loss's gradient; returns the loss."""
    h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = total = 0.0
    for i in range(n):
        c = int(views[i, 6])
        r20, r21, r22 = cams[c, R20], cams[c, R21], cams[c, R22]
        z = r20 * p[0] + r21 * p[1] + r22 * p[2] + cams[c, TZ]
        if not z > 1e-6:
            total += 2.0 * KNEE
            continue
        iz = 1.0 / z
        x = (cams[c, R00] * p[0] + cams[c, R01] * p[1] + cams[c, R02] * p[2] + cams[c, TX]) * iz
        y = (cams[c, R10] * p[0] + cams[c, R11] * p[1] + cams[c, R12] * p[2] + cams[c, TY]) * iz
        w0, w1, w2, w3 = views[i, 2], views[i, 3], views[i, 4], views[i, 5]
        rx, ry = x - views[i, 0], y - views[i, 1]
        e0, e1 = w0 * rx + w1 * ry, w2 * rx + w3 * ry
        s = e0 * e0 + e1 * e1
        weight = 1.0 if s < KNEE else (KNEE / s) ** 2
        total += loss(s)
        jx0, jx1, jx2 = (cams[c, R00] - x * r20) * iz, (cams[c, R01] - x * r21) * iz, (cams[c, R02] - x * r22) * iz
        jy0, jy1, jy2 = (cams[c, R10] - y * r20) * iz, (cams[c, R11] - y * r21) * iz, (cams[c, R12] - y * r22) * iz
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
    if planes is not None:
        for i in range(n):
            c, w = int(views[i, 6]), planes[i, 1]
            r20, r21, r22 = cams[c, R20], cams[c, R21], cams[c, R22]
            e = (r20 * p[0] + r21 * p[1] + r22 * p[2] + cams[c, TZ] - planes[i, 0]) * w
            s = e * e
            total += loss(s)
            pull = (w if s < KNEE else w * (KNEE / s) ** 2) * e
            weight = w * w if s < KNEE else w * w * (KNEE / s) ** 2
            h00 += weight * r20 * r20
            h01 += weight * r20 * r21
            h02 += weight * r20 * r22
            h11 += weight * r21 * r21
            h12 += weight * r21 * r22
            h22 += weight * r22 * r22
            g0 += pull * r20
            g1 += pull * r21
            g2 += pull * r22
    system[0], system[1], system[2], system[3], system[4], system[5] = h00, h01, h02, h11, h12, h22
    system[6], system[7], system[8] = g0, g1, g2
    return total


@fast_kernel()
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


@fast_kernel()
def refine(cams, views, n, p, work, planes=None):
    """Levenberg-Marquardt on the robust loss from p, in place; returns the loss. work: (3, 9)."""
    here, there, step, ahead = work[0], work[1], work[2, :3], work[2, 3:]
    best = normal_system(cams, views, n, p, here, planes)
    damping = 0.0
    for _ in range(20):
        if not solve3(here, damping, step):
            damping = max(1e-6, 10.0 * damping)
            if damping > 1e3:
                break
            continue
        for i in range(3):
            ahead[i] = p[i] + step[i]
        loss_there = normal_system(cams, views, n, ahead, there, planes)
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


@fast_kernel()
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
