"""Lens models: where a ray meets the image plane, and back.

Both models are OpenCV's, with its order of coefficients. `xy_norm` is x/z, y/z in camera axes.

- ``pinhole``: 0, 4, 5, 8, 12 or 14 coefficients
  k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tau_x tau_y]]]]: radial (rational), tangential, thin prism, tilted sensor.
- ``fisheye``: 4 coefficients k1..k4 of the angle polynomial (Kannala & Brandt 2006, equidistant).

The inverse is Newton's method on the exact model to machine precision. Outside the part of the image where the
model can be inverted the answer is NaN, never a wrong ray.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .arrays import Array

PINHOLE_COUNTS = (0, 4, 5, 8, 12, 14)
FISHEYE_COUNT = 4
ITERATIONS = 30
CONVERGED_NORM = 1e-12
ACCEPTED_NORM = 1e-7


def distort(xy_norm: Array, coefficients: Array, model: str) -> Array:
    """Distorted image-plane points (..., 2) of ideal ones (..., 2), both before the intrinsic matrix."""
    if len(coefficients) == 0:
        return xy_norm
    if model == "fisheye":
        return _fisheye_distort(xy_norm, coefficients)
    bent, _ = _brown(xy_norm, padded(coefficients))
    return _on_tilted_sensor(bent, coefficients)


def undistort(xy_bent: Array, coefficients: Array, model: str) -> Array:
    """Ideal image-plane points (..., 2) of distorted ones (..., 2); NaN where the model has no inverse."""
    if len(coefficients) == 0:
        return xy_bent
    if model == "fisheye":
        return _fisheye_undistort(xy_bent, coefficients)
    return _brown_inverse(_on_tilted_sensor(xy_bent, coefficients, inverse=True), padded(coefficients))


def slopes(xy_norm: Array, coefficients: Array, model: str) -> Array:
    """Derivatives (..., 2, 2) of `distort` at ideal image-plane points (..., 2); NaN where these are."""
    if len(coefficients) == 0:
        return np.broadcast_to(np.eye(2), (*xy_norm.shape, 2))
    if model == "fisheye":
        return _fisheye_slopes(xy_norm, coefficients)
    bent, by_ideal = _brown(xy_norm, padded(coefficients))
    if len(coefficients) < 14:
        return by_ideal
    matrix = tilt_matrix(float(coefficients[12]), float(coefficients[13]))
    moved = bent @ matrix[:, :2].T + matrix[:, 2]
    along, depth = moved[..., :2] / moved[..., 2:], moved[..., 2, None, None]
    return np.asarray((matrix[:2, :2] - along[..., None] * matrix[2, :2]) / depth @ by_ideal)


def padded(coefficients: Array) -> Array:
    """(14,) with zeros for those that are not given."""
    return np.concatenate([coefficients, np.zeros(14 - len(coefficients))])


def brown(x: Any, y: Any, k: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
    """Radial, tangential and prism part of a point or of many: bent x, y, and derivatives x by x, x by y, y by x, y by y.

    Arithmetic alone, because `fusion.kernels.lens` compiles it.
    """
    r2 = x * x + y * y
    over = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    under = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    gain = over / under
    d_over = k[0] + r2 * (2 * k[1] + r2 * 3 * k[4])
    d_under = k[5] + r2 * (2 * k[6] + r2 * 3 * k[7])
    d_gain = (d_over - gain * d_under) / under
    bent_x = x * gain + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x) + r2 * (k[8] + r2 * k[9])
    bent_y = y * gain + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y + r2 * (k[10] + r2 * k[11])
    d_prism_x, d_prism_y = k[8] + 2 * r2 * k[9], k[10] + 2 * r2 * k[11]
    x_by_x = gain + 2 * x * x * d_gain + 2 * k[2] * y + 6 * k[3] * x + 2 * x * d_prism_x
    y_by_y = gain + 2 * y * y * d_gain + 6 * k[2] * y + 2 * k[3] * x + 2 * y * d_prism_y
    without_prism = 2 * x * y * d_gain + 2 * k[2] * x + 2 * k[3] * y
    return bent_x, bent_y, x_by_x, without_prism + 2 * y * d_prism_x, without_prism + 2 * x * d_prism_y, y_by_y


def _brown(xy: Array, k: Array) -> tuple[Array, Array]:
    """`brown` of points (..., 2): bent points (..., 2) and their Jacobian (..., 2, 2)."""
    bent_x, bent_y, *slopes = brown(xy[..., 0], xy[..., 1], k)
    return np.stack([bent_x, bent_y], axis=-1), np.stack(slopes, axis=-1).reshape(*xy.shape, 2)


def _brown_inverse(bent: Array, k: Array) -> Array:
    xy = np.array(bent, np.float64)
    with np.errstate(all="ignore"):
        for _ in range(ITERATIONS):
            guess, jacobian = _brown(xy, k)
            error = guess - bent
            a, b, c, d = jacobian[..., 0, 0], jacobian[..., 0, 1], jacobian[..., 1, 0], jacobian[..., 1, 1]
            # past the fold of the model the determinant changes sign: there is no inverse beyond it
            det = np.where(a * d - b * c > 0, a * d - b * c, np.nan)
            step = np.stack([d * error[..., 0] - b * error[..., 1], a * error[..., 1] - c * error[..., 0]], axis=-1)
            step = step / det[..., None]
            xy = xy - step
            if not (np.abs(step) > CONVERGED_NORM).any():
                break
        left = np.abs(_brown(xy, k)[0] - bent).max(axis=-1, keepdims=True)
        return np.where(left < ACCEPTED_NORM, xy, np.nan)


def tilt_matrix(tau_x_rad: float, tau_y_rad: float) -> Array:
    """Scheimpflug homography of a sensor tilted about its x, then its y axis (as OpenCV defines it)."""
    cx, sx, cy, sy = np.cos(tau_x_rad), np.sin(tau_x_rad), np.cos(tau_y_rad), np.sin(tau_y_rad)
    about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    turn = about_y @ about_x
    onto_plane = np.array([[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]])
    return np.asarray(onto_plane @ turn)


def _on_tilted_sensor(xy: Array, coefficients: Array, *, inverse: bool = False) -> Array:
    """Points (..., 2) on the sensor of points on one that is not tilted, or the inverse."""
    if len(coefficients) < 14:
        return xy
    matrix = tilt_matrix(float(coefficients[12]), float(coefficients[13]))
    matrix = np.linalg.inv(matrix) if inverse else matrix
    moved = xy @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(moved[..., :2] / moved[..., 2:])


def _fisheye_bent(angle: Array, k: Array) -> Array:
    """Distance from the principal point, in focal lengths, of rays at these angles from the optical axis."""
    a2 = angle * angle
    return np.asarray(angle * (1 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3])))))


def _fisheye_slope(angle: Array, k: Array) -> Array:
    """Derivative of `_fisheye_bent` by the angle."""
    a2 = angle * angle
    return np.asarray(1 + a2 * (3 * k[0] + a2 * (5 * k[1] + a2 * (7 * k[2] + a2 * 9 * k[3]))))


def _fisheye_distort(xy: Array, k: Array) -> Array:
    radius = np.linalg.norm(xy, axis=-1, keepdims=True)
    bent = _fisheye_bent(np.arctan(radius), k)
    return np.asarray(xy * np.where(radius > 1e-12, bent / np.where(radius > 0, radius, 1.0), 1.0))


def _fisheye_slopes(xy: Array, k: Array) -> Array:
    """As the radius grows, along it by the slope of the polynomial, across it as much as the radius itself."""
    radius = np.linalg.norm(xy, axis=-1, keepdims=True)[..., None]
    off_axis = radius > 1e-12
    safe = np.where(off_axis, radius, 1.0)
    angle = np.arctan(radius)
    along = _fisheye_slope(angle, k) / (1 + radius * radius)
    across = np.where(off_axis, _fisheye_bent(angle, k) / safe, 1.0)
    outward = xy[..., None] / safe
    return np.asarray(across * np.eye(2) + (along - across) * outward * np.swapaxes(outward, -1, -2))


def _fisheye_undistort(xy_bent: Array, k: Array) -> Array:
    bent = np.linalg.norm(xy_bent, axis=-1, keepdims=True)
    angle = np.clip(bent, 0, np.pi / 2)
    with np.errstate(all="ignore"):
        for _ in range(ITERATIONS):
            slope = _fisheye_slope(angle, k)
            step = (_fisheye_bent(angle, k) - bent) / np.where(slope > 0, slope, np.nan)
            angle = angle - step
            if not (np.abs(step) > CONVERGED_NORM).any():
                break
        left = np.abs(_fisheye_bent(angle, k) - bent)
        good = (left < ACCEPTED_NORM) & (angle >= 0) & (angle < np.pi / 2)
        scale = np.where(bent > 1e-12, np.tan(angle) / np.where(bent > 0, bent, 1.0), 1.0)
        return np.where(good, xy_bent * scale, np.nan)
