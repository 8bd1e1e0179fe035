"""The turn of a limb about its long axis, from the plane it bends in: a scalar Kalman filter."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

from .frames import cross, dot, free_frame, normal_to, variance

# rows of a plane memory: z and y in parent axes, z and y in world axes, variance
MEMORY_SIZE = 13
# a plane: normal z, variance of its turn; variance of the plane seen now, and the part of that due to the points
PLANE_SIZE = 6
UNKNOWN_VAR = 1.0  # rad^2 of a plane guessed from the parent's Z axis


@kernel()
def step_planes(
    points, points_cov, limb_points, bends, parents, pairs, axes, memory, grown_var, hinge_var, expected, updated
):  # fmt: skip
    """`plane_step` of every limb; `memory` (L, MEMORY_SIZE), `expected` and `updated` (L, PLANE_SIZE)."""
    parent = np.empty((3, 3))
    by_first = np.empty((3, 3))
    by_second = np.empty((3, 3))
    for i in range(limb_points.shape[0]):
        s = parents[i]
        free_frame(points, pairs[s], axes[s, 0], axes[s, 1], parent, by_first, by_second)
        plane_step(points, points_cov, limb_points[i], bends[i], parent, memory[i], grown_var, hinge_var, expected[i], updated[i])


@kernel()
def plane_step(points, points_cov, limb, bend, parent, memory, grown_var, hinge_var, expected, updated):
    """One step of a limb's plane filter; writes the plane (6,) before and after the new points, and the memory."""
    expected[:] = np.nan
    updated[:] = np.nan
    upper = points[limb[0]] - points[limb[1]]
    length = math.sqrt(dot(upper, upper))
    if math.isnan(length) or length < 1e-9:
        memory[12] += grown_var
        return
    y = upper / length
    z, var = _carried(memory, parent, y, grown_var)
    expected[:3] = z
    expected[3] = var
    if math.isnan(var):
        z, var = _first_plane(points, limb, bend, y)
        if math.isnan(var):
            return
    turn, seen_var, points_var = _seen_turn(points, points_cov, limb, bend, y, z, hinge_var)
    if seen_var < np.inf:
        gain = var / (var + seen_var) if var + seen_var > 0.0 else 1.0
        # a limb bent the other way round than expected: the plane was wrong, not the measurement
        if abs(turn) > 0.5 * math.pi:
            gain = 1.0
            var = seen_var
        else:
            var = gain * seen_var
        x = cross(y, z)
        z = math.cos(gain * turn) * z + math.sin(gain * turn) * x
    updated[:3] = z
    updated[3] = var
    updated[4] = seen_var
    updated[5] = points_var
    _remember(memory, parent, y, z, var)


@kernel()
def _carried(memory, parent, y, grown_var):
    """The plane normal expected now and its variance, NaN when nothing is known; `parent` may be NaN."""
    has_parent = not math.isnan(parent[0, 0])
    nothing = math.isnan(memory[12])
    if has_parent and (nothing or math.isnan(memory[0])) and math.isnan(memory[6]):
        z = np.ascontiguousarray(parent[:, 2])
        z, breadth = normal_to(z, y)
        if breadth < 0.2:
            return np.full(3, np.nan), np.nan
        return z, UNKNOWN_VAR
    if nothing:
        return np.full(3, np.nan), np.nan
    if has_parent and not math.isnan(memory[0]):
        rotation = np.ascontiguousarray(parent)
        return _followed(rotation @ memory[0:3], rotation @ memory[3:6], y), memory[12] + grown_var
    return _followed(memory[6:9].copy(), memory[9:12].copy(), y), memory[12] + grown_var


@kernel()
def _followed(z, y_before, y):
    """z turned by the smallest rotation that takes y_before to y."""
    axis = cross(y_before, y)
    cosine = dot(y_before, y)
    if cosine < -0.999999:
        return z
    moved = z + cross(axis, z) + cross(axis, cross(axis, z)) / (1.0 + cosine)
    out, _ = normal_to(moved, y)
    return out


@kernel()
def _seen_turn(points, points_cov, limb, bend, y, z, hinge_var):
    """Turn about y from the expected plane to the seen one, its variance, and the part of it due to the points."""
    middle = points[limb[1]]
    upper = points[limb[0]] - middle
    lower = bend * (points[limb[2]] - middle)
    if math.isnan(lower[0]):
        return 0.0, np.inf, 0.0
    length = math.sqrt(dot(upper, upper))
    x = cross(y, z)
    forward, side = dot(lower, x), dot(lower, z)
    breadth = math.sqrt(forward * forward + side * side)
    if breadth < 1e-9:
        return 0.0, np.inf, 0.0
    normal = cross(lower, y) / breadth
    ratio = bend * dot(lower, y) / length
    spread = variance(points_cov[limb[2]], normal)
    spread += variance(points_cov[limb[1]], normal) * (1.0 - ratio) ** 2
    spread += variance(points_cov[limb[0]], normal) * ratio**2
    points_var = spread / (breadth * breadth)
    spread += hinge_var * dot(lower, lower)
    relative = spread / (breadth * breadth)
    # near straight the seen breadth is mostly noise: count it out smoothly, so that nothing jumps
    var = relative * (1.0 + (9.0 * relative) ** 2)
    turn = math.atan2(-side, forward)
    hyperextended = breadth < 0.2 * math.sqrt(dot(lower, lower)) + 3.0 * math.sqrt(spread)
    if abs(turn) > 0.5 * math.pi and hyperextended:
        turn -= math.copysign(math.pi, turn)
    return turn, var, points_var


@kernel()
def _first_plane(points, limb, bend, y):
    """Without a parent the first plane is taken as it is, if the limb is clearly bent."""
    lower = bend * (points[limb[2]] - points[limb[1]])
    normal, breadth = normal_to(cross(lower, y), y)
    if math.isnan(breadth) or breadth < 0.25 * math.sqrt(dot(lower, lower)):
        return normal, np.nan
    return normal, UNKNOWN_VAR


@kernel()
def _remember(memory, parent, y, z, var):
    for i in range(3):
        memory[i] = parent[0, i] * z[0] + parent[1, i] * z[1] + parent[2, i] * z[2]
        memory[3 + i] = parent[0, i] * y[0] + parent[1, i] * y[1] + parent[2, i] * y[2]
        memory[6 + i] = z[i]
        memory[9 + i] = y[i]
    memory[12] = var
