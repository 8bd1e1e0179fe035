"""Lenses: ideal image points to raw pixels and back, with derivatives. Cameras come as rows of `packed.packed_rig`."""

from __future__ import annotations

import math

from . import packed as at
from .packed import fast_kernel


@fast_kernel()
def bend(cam, x, y):
    """Raw px (u, v) of an ideal point and their derivatives (u_x, u_y, v_x, v_y)."""
    model = cam[at.MODEL]
    bx, by, a, b, c, d = x, y, 1.0, 0.0, 0.0, 1.0
    if model == at.FISHEYE:
        bx, by, a, b, c, d = _bend_fisheye(cam, x, y)
    elif model > at.NO_LENS:
        bx, by, a, b, c, d = _bend_brown(cam, x, y)
        if model == at.BROWN_TILTED:
            bx, by, a, b, c, d = _tilt(cam, bx, by, a, b, c, d)
    fx, skew, fy = cam[at.FX], cam[at.SKEW], cam[at.FY]
    return (
        fx * bx + skew * by + cam[at.CX],
        fy * by + cam[at.CY],
        fx * a + skew * c,
        fx * b + skew * d,
        fy * c,
        fy * d,
    )


@fast_kernel()
def _bend_brown(cam, x, y):
    k1, k2, p1, p2, k3, k4 = cam[at.K1], cam[at.K2], cam[at.P1], cam[at.P2], cam[at.K3], cam[at.K4]
    k5, k6, s1, s2, s3, s4 = cam[at.K5], cam[at.K6], cam[at.S1], cam[at.S2], cam[at.S3], cam[at.S4]
    return _brown(x, y, k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4)


@fast_kernel(inline="always")
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


@fast_kernel()
def _tilt(cam, bx, by, a, b, c, d):
    w = 1.0 / (cam[at.T20] * bx + cam[at.T21] * by + cam[at.T22])
    u = (cam[at.T00] * bx + cam[at.T01] * by + cam[at.T02]) * w
    v = (cam[at.T10] * bx + cam[at.T11] * by + cam[at.T12]) * w
    ux, uy = (cam[at.T00] - u * cam[at.T20]) * w, (cam[at.T01] - u * cam[at.T21]) * w
    vx, vy = (cam[at.T10] - v * cam[at.T20]) * w, (cam[at.T11] - v * cam[at.T21]) * w
    return u, v, ux * a + uy * c, ux * b + uy * d, vx * a + vy * c, vx * b + vy * d


@fast_kernel()
def _bend_fisheye(cam, x, y):
    r = math.sqrt(x * x + y * y)
    if r < 1e-9:
        return x, y, 1.0, 0.0, 0.0, 1.0
    angle = math.atan(r)
    a2 = angle * angle
    bent = angle * (1.0 + a2 * (cam[at.F1] + a2 * (cam[at.F2] + a2 * (cam[at.F3] + a2 * cam[at.F4]))))
    slope = 1.0 + a2 * (3.0 * cam[at.F1] + a2 * (5.0 * cam[at.F2] + a2 * (7.0 * cam[at.F3] + a2 * 9.0 * cam[at.F4])))
    gain = bent / r
    d_gain = (slope / (1.0 + r * r) - gain) / (r * r)
    cross = x * y * d_gain
    return x * gain, y * gain, gain + x * x * d_gain, cross, cross, gain + y * y * d_gain


@fast_kernel()
def straighten(cam, u, v):
    """Ideal point (x, y) of a raw px and the lens's derivatives there (before the intrinsics): Newton; NaN: no inverse."""
    by = (v - cam[at.CY]) / cam[at.FY]
    bx = (u - cam[at.CX] - cam[at.SKEW] * by) / cam[at.FX]
    model = cam[at.MODEL]
    if model == at.NO_LENS:
        return bx, by, 1.0, 0.0, 0.0, 1.0
    if model == at.FISHEYE:
        x, y = _straighten_fisheye(cam, bx, by)
        _, _, a, b, c, d = _bend_fisheye(cam, x, y)
        return x, y, a, b, c, d
    if model == at.BROWN:
        return _straighten_brown(cam, bx, by)
    w = 1.0 / (cam[at.U20] * bx + cam[at.U21] * by + cam[at.U22])
    x, y, a, b, c, d = _straighten_brown(
        cam, (cam[at.U00] * bx + cam[at.U01] * by + cam[at.U02]) * w, (cam[at.U10] * bx + cam[at.U11] * by + cam[at.U12]) * w
    )
    gx, gy, _, _, _, _ = _bend_brown(cam, x, y)
    _, _, a, b, c, d = _tilt(cam, gx, gy, a, b, c, d)
    return x, y, a, b, c, d


@fast_kernel()
def _straighten_brown(cam, bx, by):
    r2 = bx * bx + by * by
    over = 1.0 + r2 * (cam[at.K1] + r2 * (cam[at.K2] + r2 * cam[at.K3]))
    under = 1.0 + r2 * (cam[at.K4] + r2 * (cam[at.K5] + r2 * cam[at.K6]))
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


@fast_kernel()
def _straighten_fisheye(cam, bx, by):
    bent = math.sqrt(bx * bx + by * by)
    angle = min(bent, 0.5 * math.pi)
    for _ in range(30):
        a2 = angle * angle
        value = angle * (1.0 + a2 * (cam[at.F1] + a2 * (cam[at.F2] + a2 * (cam[at.F3] + a2 * cam[at.F4])))) - bent
        slope = 1.0 + a2 * (3.0 * cam[at.F1] + a2 * (5.0 * cam[at.F2] + a2 * (7.0 * cam[at.F3] + a2 * 9.0 * cam[at.F4])))
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


@fast_kernel()
def _straighten_brown_row(cam, xy, out, last):
    """`straighten` of one camera's K px (K, 2) into out (6, K), three Newton steps side by side; last (K,) squared steps."""
    cx, cy, skew, ifx, ify = cam[at.CX], cam[at.CY], cam[at.SKEW], 1.0 / cam[at.FX], 1.0 / cam[at.FY]
    k1, k2, p1, p2, k3, k4 = cam[at.K1], cam[at.K2], cam[at.P1], cam[at.P2], cam[at.K3], cam[at.K4]
    k5, k6, s1, s2, s3, s4 = cam[at.K5], cam[at.K6], cam[at.S1], cam[at.S2], cam[at.S3], cam[at.S4]
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


@fast_kernel()
def straighten_group(cams, xy_img, ideal, last):
    """`straighten` of every view of a group, xy_img (C, K, 2), into ideal (C, 6, K). last (K,) is scratch."""
    for c in range(len(cams)):
        by_row = cams[c, at.MODEL] == at.BROWN
        if by_row:
            _straighten_brown_row(cams[c], xy_img[c], ideal[c], last)
        for k in range(xy_img.shape[1]):
            # few need more than three steps; the full search finds those without an inverse
            if by_row and last[k] < 1e-13:
                continue
            u, v = xy_img[c, k, 0], xy_img[c, k, 1]
            if not (math.isfinite(u) and math.isfinite(v)):
                ideal[c, 0, k] = math.nan
                continue
            x, y, a, b, cc, d = straighten(cams[c], u, v)
            ideal[c, 0, k], ideal[c, 1, k], ideal[c, 2, k] = x, y, a
            ideal[c, 3, k], ideal[c, 4, k], ideal[c, 5, k] = b, cc, d
