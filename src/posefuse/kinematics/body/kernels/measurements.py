"""What points, rays, habits and limits of joints add to the normal equations."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

from .tree import BALL, log3

LIMIT_SD = 0.03


@kernel()
def point_information(x, seen, information, robust, gradient, out):
    """Student-t weighted information of a measured 3D point about the place x; returns its squared distance."""
    distance = 0.0
    pulled = np.zeros(3)
    for i in range(3):
        for j in range(3):
            pulled[i] += information[i, j] * (seen[j] - x[j])
        distance += (seen[i] - x[i]) * pulled[i]
    weight = (robust + 3.0) / (robust + distance)
    for i in range(3):
        gradient[i] += weight * pulled[i]
        for j in range(3):
            out[i, j] += weight * information[i, j]
    return distance


@kernel()
def ray_information(x, projections, xy, inverse_var, robust, gradient, out):
    """The same of undistorted pixels (C, 2) in cameras (C, 3, 4); cameras with no information count nothing."""
    jacobian = np.empty((2, 3))
    for c in range(projections.shape[0]):
        if not inverse_var[c] > 0.0:
            continue
        m = projections[c]
        u = m[0, 0] * x[0] + m[0, 1] * x[1] + m[0, 2] * x[2] + m[0, 3]
        v = m[1, 0] * x[0] + m[1, 1] * x[1] + m[1, 2] * x[2] + m[1, 3]
        w = m[2, 0] * x[0] + m[2, 1] * x[1] + m[2, 2] * x[2] + m[2, 3]
        if w <= 0.0:
            continue
        u, v = u / w, v / w
        for i in range(3):
            jacobian[0, i] = (m[0, i] - u * m[2, i]) / w
            jacobian[1, i] = (m[1, i] - v * m[2, i]) / w
        e, f = xy[c, 0] - u, xy[c, 1] - v
        weight = inverse_var[c] * (robust + 2.0) / (robust + (e * e + f * f) * inverse_var[c])
        for i in range(3):
            gradient[i] += weight * (jacobian[0, i] * e + jacobian[1, i] * f)
            for j in range(3):
                out[i, j] += weight * (jacobian[0, i] * jacobian[0, j] + jacobian[1, i] * jacobian[1, j])


@kernel()
def add(columns, values, count, gradient, information, hessian, slope):
    """Add J^T information J and J^T gradient of one point."""
    carried = np.empty(3)
    for a in range(count):
        for i in range(3):
            carried[i] = information[i, 0] * values[a, 0] + information[i, 1] * values[a, 1] + information[i, 2] * values[a, 2]
        slope[columns[a]] += gradient[0] * values[a, 0] + gradient[1] * values[a, 1] + gradient[2] * values[a, 2]
        for b in range(count):
            hessian[columns[a], columns[b]] += carried[0] * values[b, 0] + carried[1] * values[b, 1] + carried[2] * values[b, 2]


@kernel()
def _pull(hessian, slope, at, residual, sd):
    hessian[at, at] += 1.0 / (sd * sd)
    slope[at] += residual / (sd * sd)


@kernel()
def habits(kind, dof, preferred_sd, limits, mirrored, q, rot, hessian, slope):
    """What humans do not do: preferences for zero of unlimited spread per second, and soft ends of each range."""
    for n in range(kind.shape[0]):
        if kind[n] == BALL:
            if preferred_sd[n] < np.inf:
                turned = log3(rot[n])
                for k in range(3):
                    _pull(hessian, slope, dof[n] + k, -turned[k], preferred_sd[n])
            if limits[n, 0, 0] < limits[n, 0, 1]:
                _ball_limits(rot[n], dof[n], limits[n], mirrored[n], hessian, slope)
            continue
        if preferred_sd[n] < np.inf:
            _pull(hessian, slope, dof[n], -q[n], preferred_sd[n])
        if limits[n, 0, 0] < limits[n, 0, 1]:
            over = max(0.0, q[n] - limits[n, 0, 1]) + min(0.0, q[n] - limits[n, 0, 0])
            if over != 0.0:
                _pull(hessian, slope, dof[n], -over, LIMIT_SD)


@kernel()
def _ball_limits(r, at, limits, mirrored, hessian, slope):
    """Soft limits on the three ZXY angles of a ball joint, mirrored on the left."""
    sign = -1.0 if mirrored else 1.0
    cosine = math.hypot(r[2, 0], r[2, 2])
    if cosine < 0.2:
        return
    angles = (math.atan2(-r[0, 1], r[1, 1]), sign * math.atan2(r[2, 1], cosine), sign * math.atan2(-r[2, 0], r[2, 2]))
    over = np.empty(3)
    for k in range(3):
        over[k] = max(0.0, angles[k] - limits[k, 1]) + min(0.0, angles[k] - limits[k, 0])
    if not over.any():
        return
    axes = np.zeros((3, 3))
    axes[2, 0] = 1.0
    axes[0, 1], axes[1, 1] = sign * math.cos(angles[0]), sign * math.sin(angles[0])
    axes[:, 2] = sign * r[:, 1]
    rates = np.linalg.inv(axes) @ r
    for k in range(3):
        if over[k] != 0.0:
            for i in range(3):
                slope[at + i] -= rates[k, i] * over[k] / (LIMIT_SD * LIMIT_SD)
                for j in range(3):
                    hessian[at + i, at + j] += rates[k, i] * rates[k, j] / (LIMIT_SD * LIMIT_SD)
