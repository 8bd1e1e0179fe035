"""The compiled mathematics of segment frames and joint angles.

A frame errs by a small rotation vector omega (world axes), linear in the errors of its points; the angles of a joint err
by M^-1 (omega_child - omega_parent), where the columns of M are the joint's three rotation axes. So covariances of the
points become standard deviations of the angles in closed form.

The turn of a limb's segments about their long axes comes from the plane of the limb, which a straight limb does not have.
It is a scalar Kalman filter: the last plane is carried in the axes of the parent segment by the smallest rotation that
follows the long axis, its variance grows with time, and each new plane counts by its own variance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array
from posefuse.foundation.compiled import kernel

# Vectors of three, written out: calls into BLAS would cost more than they compute.


@kernel()
def vector_between_midpoints(points, from_pair, to_pair):
    """From the middle of one pair of points to that of another."""
    out = np.empty(3)
    for i in range(3):
        out[i] = 0.5 * (points[to_pair[0], i] + points[to_pair[1], i] - points[from_pair[0], i] - points[from_pair[1], i])
    return out


@kernel()
def dot(a, b):
    """a . b"""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel()
def cross(a, b):
    """a x b"""
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out


@kernel()
def normal_to(v, unit):
    """Unit vector along the part of v normal to `unit`, and the length of that part."""
    out = v - dot(v, unit) * unit
    norm = math.sqrt(dot(out, out))
    return out / norm, norm


@kernel()
def variance(cov, direction):
    """Along a direction of any length: direction^T cov direction."""
    out = 0.0
    for i in range(3):
        for j in range(3):
            out += direction[i] * cov[i, j] * direction[j]
    return out


_ROUNDING = 1e-6


@kernel()
def gather_landmarks(xyz, cov, pairs, default_var, points, points_cov):
    """Landmarks (P, 3) and covariances (P, 3, 3) as means of keypoint pairs; unknown covariance becomes `default_var`."""
    for p in range(pairs.shape[0]):
        a, b = pairs[p, 0], pairs[p, 1]
        if a < 0:
            points[p] = np.nan
            points_cov[p] = np.nan
            continue
        points[p] = 0.5 * (xyz[a] + xyz[b])
        if a == b:
            points_cov[p] = cov[a]
        else:
            points_cov[p] = 0.25 * (cov[a] + cov[b])
        if math.isnan(points_cov[p, 0, 0]):
            points_cov[p] = 0.0
            for i in range(3):
                points_cov[p, i, i] = default_var


@kernel()
def free_frame(points, pairs, first_axis, second_axis, rotation, by_first, by_second):
    """Frame (3, 3, columns are axes) of a first and a second vector, and omega's derivatives by both."""
    first = vector_between_midpoints(points, pairs[1], pairs[2])
    second = vector_between_midpoints(points, pairs[3], pairs[4])
    length = math.sqrt(dot(first, first))
    u = first / length
    w, breadth = normal_to(second, u)
    k = cross(u, w)
    sign = 1.0 if second_axis == (first_axis + 1) % 3 else -1.0
    along = dot(second, u)
    for i in range(3):
        rotation[i, first_axis] = u[i]
        rotation[i, second_axis] = w[i]
        rotation[i, 3 - first_axis - second_axis] = sign * k[i]
        for j in range(3):
            by_first[i, j] = (k[i] * w[j] - w[i] * k[j] - along / breadth * u[i] * k[j]) / length
            by_second[i, j] = u[i] * k[j] / breadth


@kernel()
def limb_frame(points, pairs, normal, rotation, by_first):
    """Frame of a limb's segment: Y along it, Z as near to `normal` as can be; omega's derivatives without its turn about Y."""
    first = vector_between_midpoints(points, pairs[1], pairs[2])
    length = math.sqrt(dot(first, first))
    y = first / length
    z, _ = normal_to(normal, y)
    x = cross(y, z)
    for i in range(3):
        rotation[i, 0], rotation[i, 1], rotation[i, 2] = x[i], y[i], z[i]
        for j in range(3):
            by_first[i, j] = (x[i] * z[j] - z[i] * x[j]) / length


@kernel()
def _add_turn(y, factor, of, out):
    """Add to omega's derivatives (3, 3) the turn about y that others have."""
    for j in range(3):
        turn = factor * dot(y, of[:, j])
        for i in range(3):
            out[i, j] += turn * y[i]


@kernel()
def upper_frame(points, pairs, plane, rotation, by_first, by_second):
    """Frame of a limb's upper segment, turned by `plane`; returns the variance of the turn not due to these points."""
    free_frame(points, pairs, 1, 0, rotation, by_first, by_second)
    free_by_first, free_by_second = by_first.copy(), by_second.copy()
    limb_frame(points, pairs, plane[:3], rotation, by_first)
    by_second[:] = 0.0
    if not plane[4] < np.inf:
        return plane[3]
    # the turn follows the seen plane only by its share of the estimate; points that err by less than a millimetre state angles
    # wrong by a quarter without it
    share = min(1.0, plane[3] / plane[4]) if plane[4] > 0.0 else 1.0
    _add_turn(rotation[:, 1], share, free_by_first, by_first)
    _add_turn(rotation[:, 1], share, free_by_second, by_second)
    return max(0.0, plane[3] - share * share * plane[5])


@kernel()
def lower_frame(points, pairs, bend, upper, upper_by_first, upper_by_second, rotation, by_first, by_second):
    """Frame of a limb's lower segment: its Z is the upper one's, so its turn errs as that one's does."""
    limb_frame(points, pairs, upper[:, 2].copy(), rotation, by_first)
    by_second[:] = 0.0
    # the two segments are spanned by the same two vectors, in the other order
    _add_turn(rotation[:, 1], -bend, upper_by_second, by_first)
    _add_turn(rotation[:, 1], bend, upper_by_first, by_second)
    return dot(rotation[:, 1], upper[:, 1]) ** 2


class BodyTable(NamedTuple):
    """What segments (S), limbs (L) and joints (Q) are made of, see `definitions`.

    pairs: (S, 5, 2) landmarks of the origin and of the ends of both vectors. axes: (S, 4) of both vectors, limb or -1, and
    whether it is the lower segment of a limb. raised: (S,) by how much a frame is turned about its own Z in the end; errors of it
    in world axes stay what they are. limb_points: (L, 3); limb_parents, bends: (L,). joint_segments: (Q, 2), -1 for the ground,
    whose axes are `ground` (3, 3); sequence, mirrored: (Q,); sign: (Q, 3); determined: (Q, 3) which angles points can show.
    """

    pairs: Array
    axes: Array
    raised: Array
    limb_points: Array
    limb_parents: Array
    bends: Array
    joint_segments: Array
    sequence: Array
    mirrored: Array
    sign: Array
    determined: Array
    ground: Array


class FrameArrays(NamedTuple):
    """Filled: rotation, by_first, by_second (S, 3, 3), turn_var (S,), see `segment_frames`."""

    rotation: Array
    by_first: Array
    by_second: Array
    turn_var: Array


@kernel()
def segment_frames(points, planes, table, frames):
    """All frames (S, 3, 3), the derivatives of their errors by both vectors, and the limbs' own turn variance (S,)."""
    pairs, axes = table.pairs, table.axes
    rotation, by_first, by_second, turn_var = frames
    for s in range(pairs.shape[0]):
        limb = axes[s, 2]
        if limb < 0:
            free_frame(points, pairs[s], axes[s, 0], axes[s, 1], rotation[s], by_first[s], by_second[s])
            turn_var[s] = 0.0
            if table.raised[s] != 0.0:
                _raise(rotation[s], table.raised[s])
        elif axes[s, 3] == 0:
            turn_var[s] = upper_frame(points, pairs[s], planes[limb], rotation[s], by_first[s], by_second[s])
        else:
            # the lower segment stands right after the upper one in the table
            u = s - 1
            turn_var[s] = turn_var[u] * lower_frame(
                points, pairs[s], table.bends[limb], rotation[u], by_first[u], by_second[u], rotation[s], by_first[s],
                by_second[s],
            )  # fmt: skip
    for s in range(pairs.shape[0]):
        # points that coincide, or are too far away to be distinguished in floating point, span no frame
        if not _is_rotation(rotation[s]):
            rotation[s] = np.nan


@kernel()
def _raise(rotation, angle):
    x, y = rotation[:, 0].copy(), rotation[:, 1].copy()
    cosine, sine = math.cos(angle), math.sin(angle)
    for i in range(3):
        rotation[i, 0] = cosine * x[i] + sine * y[i]
        rotation[i, 1] = cosine * y[i] - sine * x[i]


@kernel()
def _is_rotation(r):
    """Whether the columns of (3, 3) are unit vectors at right angles; not where one is NaN."""
    for i in range(3):
        for j in range(i, 3):
            if not abs(dot(r[:, i], r[:, j]) - (1.0 if i == j else 0.0)) < _ROUNDING:
                return False
    return True


# a plane memory: z and y in parent axes, z and y in world axes, variance, evidence that the plane is reversed
MEMORY_SIZE = 14
# a plane: normal z, variance of its turn; variance of the plane seen now, and the part of that due to the points
PLANE_SIZE = 6
UNKNOWN_VAR = 1.0  # rad^2 of a plane guessed from the parent's Z axis
# sine of the angle to which a knee or elbow may be bent beyond straight
_HYPEREXTENDED = 0.2
# log of the odds at which a plane counts as reversed: 100 to 1
REVERSED = 4.6
# what an independent look at a limb has to say more than this, so that noise of a straight limb never adds up
_EVIDENCE_LOST = 0.5


@kernel()
def step_planes(points, points_cov, table, memory, grown_var, hinge_var, repeats, expected, updated):
    """`plane_step` of every limb; `memory` (L, MEMORY_SIZE), `expected` and `updated` (L, PLANE_SIZE).

    repeats: time steps over which errors of a hinge and of points last.
    """
    parent, by_first, by_second = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(table.limb_points)):
        s = table.limb_parents[i]
        free_frame(points, table.pairs[s], table.axes[s, 0], table.axes[s, 1], parent, by_first, by_second)
        plane_step(
            points, points_cov, table.limb_points[i], table.bends[i], parent, memory[i], grown_var, hinge_var, repeats,
            expected[i], updated[i],
        )  # fmt: skip


@kernel()
def plane_step(points, points_cov, limb, bend, parent, memory, grown_var, hinge_var, repeats, expected, updated):
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
    before = 0.0 if math.isnan(memory[13]) else memory[13]
    memory[13] = evidence_against(points, points_cov, limb, bend, y, z, repeats, before)
    if memory[13] > REVERSED:
        z = -z
        memory[13] = 0.0
    turn, seen_var, points_var = _seen_turn(points, points_cov, limb, bend, y, z, hinge_var * repeats)
    if seen_var < np.inf:
        gain = var / (var + seen_var) if var + seen_var > 0.0 else 1.0
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
def evidence_against(points, points_cov, limb, bend, y, z, repeats, evidence):
    """Log of the odds that the plane z of a limb is reversed, with what these points add to `evidence`.

    How far the lower end lies forward has a Gaussian error; a limb can be bent from `_HYPEREXTENDED` on. So the odds of both
    signs are known, and add up over time, from 0 (Page, Continuous inspection schemes, Biometrika 41, 1954).
    """
    middle = points[limb[1]]
    upper = points[limb[0]] - middle
    lower = bend * (points[limb[2]] - middle)
    if math.isnan(lower[0]) or math.isnan(upper[0]):
        return evidence
    x = cross(y, z)
    ratio = bend * dot(lower, y) / math.sqrt(dot(upper, upper))
    sigma = math.sqrt(_end_variance(points_cov, limb, ratio, x))
    slack, forward = _HYPEREXTENDED * math.sqrt(dot(lower, lower)), dot(lower, x)
    more = _log_below((slack - forward) / sigma) - _log_below((slack + forward) / sigma) - _EVIDENCE_LOST
    return max(evidence + more / repeats, 0.0)


@kernel()
def _log_below(z):
    """Log of the probability that a standard normal variable is below z."""
    return math.log(0.5 * math.erfc(-max(z, -30.0) / math.sqrt(2.0)))


@kernel()
def _end_variance(points_cov, limb, ratio, direction):
    """Variance, along a direction, of the lower end of a limb seen from its upper segment."""
    out = variance(points_cov[limb[2]], direction) + variance(points_cov[limb[1]], direction) * (1.0 - ratio) ** 2
    return out + variance(points_cov[limb[0]], direction) * ratio**2


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
    spread = _end_variance(points_cov, limb, ratio, normal)
    points_var = spread / (breadth * breadth)
    spread += hinge_var * dot(lower, lower)
    relative = spread / (breadth * breadth)
    # near straight the seen breadth is mostly noise: count it out smoothly, so that nothing jumps
    var = relative * (1.0 + (9.0 * relative) ** 2)
    turn = math.atan2(-side, forward)
    hyperextended = breadth < _HYPEREXTENDED * math.sqrt(dot(lower, lower)) + 3.0 * math.sqrt(spread)
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


ZXY, YXY, YXZ, YZX = 0, 1, 2, 3


class Angles(NamedTuple):
    """Filled: angles and standard deviations (Q, 3); weights (Q, P, 3, 3), d(angles)/d(points)."""

    angles: Array
    sigmas: Array
    weights: Array


@kernel()
def solve_joints(points, points_cov, planes, table, limits, frames, out):
    """Frames, then angles; frames whose turn is less certain than the limit become NaN afterwards."""
    segment_frames(points, planes, table, frames)
    joint_angles(frames, points_cov, table, limits, out)
    for s in range(len(frames.turn_var)):
        if frames.turn_var[s] > limits[1] * limits[1]:
            frames.rotation[s] = np.nan


@kernel()
def joint_angles(frames, points_cov, table, limits, out):
    """All angles and standard deviations.

    `limits`: sine below which a joint is locked, and the standard deviation from which an angle is not given.
    """
    rotation, by_first, by_second, turn_var = frames
    pairs, mirrored, sign = table.pairs, table.mirrored, table.sign
    angles, sigmas, weights = out
    relative, axes = np.empty((3, 3)), np.empty((3, 3))
    for q in range(len(table.joint_segments)):
        parent, child = table.joint_segments[q]
        over = table.ground if parent < 0 else rotation[parent]
        angles[q] = np.nan
        sigmas[q] = np.nan
        weights[q] = 0.0
        if math.isnan(over[0, 0]) or math.isnan(rotation[child, 0, 0]):
            continue
        for i in range(3):
            for j in range(3):
                relative[i, j] = dot(over[:, i], rotation[child, :, j])
        if mirrored[q]:
            relative[2, :2] *= -1.0
            relative[:2, 2] *= -1.0
        lock = cardan(relative, table.sequence[q], angles[q], axes)
        free = lock > limits[0]
        rates = np.linalg.inv(axes) if free else np.linalg.pinv(axes)
        if mirrored[q]:
            rates[:, :2] *= -1.0
        for a in range(3):
            rates[a] *= sign[q, a]
        world = rates @ over.T
        _spread(by_first[child], by_second[child], pairs[child], 1.0, world, weights[q])
        if parent >= 0:
            _spread(by_first[parent], by_second[parent], pairs[parent], -1.0, world, weights[q])
        for a in range(3):
            var = _weighted_variance(weights[q, :, a], points_cov)
            turn = turn_var[child] * dot(world[a], rotation[child, :, 1]) ** 2
            if parent >= 0:
                turn += turn_var[parent] * dot(world[a], over[:, 1]) ** 2
            angles[q, a] *= sign[q, a]
            sigmas[q, a] = math.sqrt(max(0.0, var + turn))
            # in gimbal lock only the sum of the first and the last angle is known
            if not table.determined[q, a] or not (free or a == 1) or sigmas[q, a] > limits[1]:
                angles[q, a] = np.nan
                sigmas[q, a] = np.nan


@kernel()
def cardan(r, sequence, angles, axes):
    """Three angles of a rotation (3, 3), the axes (3, 3 columns) they turn about in parent axes, and sin of the lock angle."""
    axes[:] = 0.0
    if sequence == ZXY:
        lock = math.hypot(r[2, 0], r[2, 2])
        a, b, c = math.atan2(-r[0, 1], r[1, 1]), math.atan2(r[2, 1], lock), math.atan2(-r[2, 0], r[2, 2])
        axes[2, 0], axes[0, 1], axes[1, 1] = 1.0, math.cos(a), math.sin(a)
        last = 1
    elif sequence == YXY:
        lock = math.hypot(r[0, 1], r[2, 1])
        a, b, c = math.atan2(-r[0, 1], -r[2, 1]), math.atan2(lock, r[1, 1]), math.atan2(-r[1, 0], r[1, 2])
        # elevation is the turn by -b about X: counted positive, as ISB plots it
        axes[1, 0], axes[0, 1], axes[2, 1] = 1.0, -math.cos(a), math.sin(a)
        last = 1
    elif sequence == YXZ:
        lock = math.hypot(r[0, 2], r[2, 2])
        a, b, c = math.atan2(r[0, 2], r[2, 2]), math.atan2(-r[1, 2], lock), math.atan2(r[1, 0], r[1, 1])
        axes[1, 0], axes[0, 1], axes[2, 1] = 1.0, math.cos(a), -math.sin(a)
        last = 2
    else:
        lock = math.hypot(r[0, 0], r[2, 0])
        a, b, c = math.atan2(-r[2, 0], r[0, 0]), math.atan2(r[1, 0], lock), math.atan2(-r[1, 2], r[1, 1])
        axes[1, 0], axes[0, 1], axes[2, 1] = 1.0, math.sin(a), math.cos(a)
        last = 0
    for i in range(3):
        axes[i, 2] = r[i, last]
    angles[0], angles[1], angles[2] = a, b, c
    return lock


@kernel()
def _spread(by_first, by_second, pairs, sign, rates, weights):
    """Add the derivative of three angles by the points (P, 3 angles, 3): rates @ omega of one segment."""
    for half in range(2):
        for end in range(2):
            for which in range(2):
                direction = by_first if which == 0 else by_second
                point = pairs[1 + 2 * which + end, half]
                factor = sign * (0.5 if end == 1 else -0.5)
                for a in range(3):
                    for j in range(3):
                        for i in range(3):
                            weights[point, a, j] += factor * rates[a, i] * direction[i, j]


@kernel()
def _weighted_variance(weights, points_cov):
    var = 0.0
    for p in range(points_cov.shape[0]):
        if weights[p, 0] != 0.0 or weights[p, 1] != 0.0 or weights[p, 2] != 0.0:
            var += variance(points_cov[p], weights[p])
    return var


# no joint turns farther
_FARTHEST_TURN = 1.25 * math.pi


@kernel()
def unwrap(angles, last, table):
    """Move angles (J, 3) by whole turns to the nearest of their last values, which are then replaced.

    A person turns in the room as often as they like, but no joint turns right round: what noise of one time step has moved by a
    turn comes back.
    """
    for q in range(angles.shape[0]):
        in_room = table.joint_segments[q, 0] < 0
        for a in range(3):
            if not math.isnan(angles[q, a]):
                if not math.isnan(last[q, a]):
                    near = angles[q, a] + 2.0 * math.pi * round((last[q, a] - angles[q, a]) / (2.0 * math.pi))
                    if in_room or abs(near) < _FARTHEST_TURN:
                        angles[q, a] = near
                last[q, a] = angles[q, a]
