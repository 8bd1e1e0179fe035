"""Cameras as rows of numbers, their columns by name, and lenses: ideal image points to raw pixels and back, with derivatives.

Numba takes the columns as constants.
"""

from __future__ import annotations

import math
from functools import lru_cache, partial

import numpy as np

from posefuse.core import Camera, Rig
from posefuse.core.arrays import Array
from posefuse.core.lens import tilt_matrix
from posefuse.foundation.compiled import kernel

# sums may be contracted, but infinity and not-a-number keep their meaning
fast_kernel = partial(kernel, fastmath={"contract", "arcp", "nsz"})

# cam_from_world: rotation by rows, translation
R00, R01, R02, R10, R11, R12, R20, R21, R22 = range(9)
TX, TY, TZ = 9, 10, 11
# intrinsic matrix
FX, SKEW, CX, FY, CY = 12, 13, 14, 15, 16
# distortion in the order of OpenCV; of a fisheye its four coefficients
K1, K2, P1, P2, K3, K4, K5, K6, S1, S2, S3, S4 = range(17, 29)
F1, F2, F3, F4 = K1, K2, P1, P2
# homography of a tilted sensor by rows, and its inverse
T00, T01, T02, T10, T11, T12, T20, T21, T22 = range(29, 38)
U00, U01, U02, U10, U11, U12, U20, U21, U22 = range(38, 47)
# one of the lens models below
MODEL = 47
# optical centre in the world
X, Y, Z = 48, 49, 50
WIDTH = 51

NO_LENS, BROWN, BROWN_TILTED, FISHEYE = 0, 1, 2, 3


@lru_cache(maxsize=32)
def packed_rig(rig: Rig) -> Array:
    """(C, WIDTH) float64, columns as above; the same array for the same rig, so do not write to it."""
    return np.stack([_packed_camera(camera) for camera in rig])


def _packed_camera(camera: Camera) -> Array:
    row = np.zeros(WIDTH)
    row[R00:TX] = camera.cam_from_world.matrix().ravel()
    row[TX:FX] = camera.cam_from_world.xyz
    row[FX:K1] = [camera.K[0, 0], camera.K[0, 1], camera.K[0, 2], camera.K[1, 1], camera.K[1, 2]]
    row[K1 : K1 + min(12, len(camera.distortion))] = camera.distortion[:12]
    row[T00:U00] = row[U00:MODEL] = np.eye(3).ravel()
    if len(camera.distortion) == 14:
        tilt = tilt_matrix(float(camera.distortion[12]), float(camera.distortion[13]))
        row[T00:U00] = tilt.ravel()
        row[U00:MODEL] = np.linalg.inv(tilt).ravel()
    row[MODEL] = _model(camera)
    row[X:WIDTH] = camera.centre_world
    return row


def _model(camera: Camera) -> int:
    if not camera.distortion.any():
        return NO_LENS if camera.model == "pinhole" or len(camera.distortion) == 0 else FISHEYE
    if camera.model == "fisheye":
        return FISHEYE
    return BROWN_TILTED if len(camera.distortion) == 14 else BROWN


@fast_kernel()
def bend(cam, x, y):
    """Raw px (u, v) of an ideal point and their derivatives (u_x, u_y, v_x, v_y)."""
    model = cam[MODEL]
    bx, by, a, b, c, d = x, y, 1.0, 0.0, 0.0, 1.0
    if model == FISHEYE:
        bx, by, a, b, c, d = _bend_fisheye(cam, x, y)
    elif model > NO_LENS:
        bx, by, a, b, c, d = _bend_brown(cam, x, y)
        if model == BROWN_TILTED:
            bx, by, a, b, c, d = _tilt(cam, bx, by, a, b, c, d)
    fx, skew, fy = cam[FX], cam[SKEW], cam[FY]
    return (
        fx * bx + skew * by + cam[CX],
        fy * by + cam[CY],
        fx * a + skew * c,
        fx * b + skew * d,
        fy * c,
        fy * d,
    )


@fast_kernel()
def _bend_brown(cam, x, y):
    k1, k2, p1, p2, k3, k4 = cam[K1], cam[K2], cam[P1], cam[P2], cam[K3], cam[K4]
    k5, k6, s1, s2, s3, s4 = cam[K5], cam[K6], cam[S1], cam[S2], cam[S3], cam[S4]
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
    w = 1.0 / (cam[T20] * bx + cam[T21] * by + cam[T22])
    u = (cam[T00] * bx + cam[T01] * by + cam[T02]) * w
    v = (cam[T10] * bx + cam[T11] * by + cam[T12]) * w
    ux, uy = (cam[T00] - u * cam[T20]) * w, (cam[T01] - u * cam[T21]) * w
    vx, vy = (cam[T10] - v * cam[T20]) * w, (cam[T11] - v * cam[T21]) * w
    return u, v, ux * a + uy * c, ux * b + uy * d, vx * a + vy * c, vx * b + vy * d


@fast_kernel()
def _bend_fisheye(cam, x, y):
    r = math.sqrt(x * x + y * y)
    if r < 1e-9:
        return x, y, 1.0, 0.0, 0.0, 1.0
    angle = math.atan(r)
    a2 = angle * angle
    bent = angle * (1.0 + a2 * (cam[F1] + a2 * (cam[F2] + a2 * (cam[F3] + a2 * cam[F4]))))
    slope = 1.0 + a2 * (3.0 * cam[F1] + a2 * (5.0 * cam[F2] + a2 * (7.0 * cam[F3] + a2 * 9.0 * cam[F4])))
    gain = bent / r
    d_gain = (slope / (1.0 + r * r) - gain) / (r * r)
    cross = x * y * d_gain
    return x * gain, y * gain, gain + x * x * d_gain, cross, cross, gain + y * y * d_gain


@fast_kernel()
def straighten(cam, u, v):
    """Ideal point (x, y) of a raw px and the lens's derivatives there (before the intrinsics): Newton; NaN: no inverse."""
    by = (v - cam[CY]) / cam[FY]
    bx = (u - cam[CX] - cam[SKEW] * by) / cam[FX]
    model = cam[MODEL]
    if model == NO_LENS:
        return bx, by, 1.0, 0.0, 0.0, 1.0
    if model == FISHEYE:
        x, y = _straighten_fisheye(cam, bx, by)
        _, _, a, b, c, d = _bend_fisheye(cam, x, y)
        return x, y, a, b, c, d
    if model == BROWN:
        return _straighten_brown(cam, bx, by)
    w = 1.0 / (cam[U20] * bx + cam[U21] * by + cam[U22])
    x, y, a, b, c, d = _straighten_brown(
        cam, (cam[U00] * bx + cam[U01] * by + cam[U02]) * w, (cam[U10] * bx + cam[U11] * by + cam[U12]) * w
    )
    gx, gy, _, _, _, _ = _bend_brown(cam, x, y)
    _, _, a, b, c, d = _tilt(cam, gx, gy, a, b, c, d)
    return x, y, a, b, c, d


@fast_kernel()
def _straighten_brown(cam, bx, by):
    r2 = bx * bx + by * by
    over = 1.0 + r2 * (cam[K1] + r2 * (cam[K2] + r2 * cam[K3]))
    under = 1.0 + r2 * (cam[K4] + r2 * (cam[K5] + r2 * cam[K6]))
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
        value = angle * (1.0 + a2 * (cam[F1] + a2 * (cam[F2] + a2 * (cam[F3] + a2 * cam[F4])))) - bent
        slope = 1.0 + a2 * (3.0 * cam[F1] + a2 * (5.0 * cam[F2] + a2 * (7.0 * cam[F3] + a2 * 9.0 * cam[F4])))
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
    cx, cy, skew, ifx, ify = cam[CX], cam[CY], cam[SKEW], 1.0 / cam[FX], 1.0 / cam[FY]
    k1, k2, p1, p2, k3, k4 = cam[K1], cam[K2], cam[P1], cam[P2], cam[K3], cam[K4]
    k5, k6, s1, s2, s3, s4 = cam[K5], cam[K6], cam[S1], cam[S2], cam[S3], cam[S4]
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
        by_row = cams[c, MODEL] == BROWN
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
