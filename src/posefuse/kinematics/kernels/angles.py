"""Segment frames to joint angles with standard deviations, and why one is not given."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array
from posefuse.foundation.compiled import kernel

from .frames import dot, segment_frames, variance

DEFINED, NOT_DETERMINED, MISSING, STRAIGHT_LIMB, GIMBAL_LOCK, UNCERTAIN = 0, 1, 2, 3, 4, 5
ZXY, YXY, YXZ, YZX = 0, 1, 2, 3


class JointTable(NamedTuple):
    """What the angles (Q, 3) of all joints are made of: segments (Q, 2), sequence and mirrored (Q,), sign (Q, 3)."""

    segments: Array
    sequence: Array
    mirrored: Array
    sign: Array
    ground: Array


class SegmentTable(NamedTuple):
    """What the frames of all segments (S) are made of, see `segment_frames`."""

    pairs: Array
    axes: Array
    raised: Array
    bends: Array


class FrameArrays(NamedTuple):
    """Filled: rotation, by_first, by_second (S, 3, 3), turn_var (S,), see `segment_frames`."""

    rotation: Array
    by_first: Array
    by_second: Array
    turn_var: Array


class Angles(NamedTuple):
    """Filled: angles, standard deviations and reasons (Q, 3); weights (Q, P, 3, 3), d(angles)/d(points)."""

    angles: Array
    sigmas: Array
    reasons: Array
    weights: Array


@kernel()
def solve_joints(points, points_cov, planes, table, joints, determined, limits, frames, out):
    """Frames, then angles; frames whose turn is less certain than the limit become NaN afterwards."""
    rotation, by_first, by_second, turn_var = frames
    segment_frames(points, planes, table.pairs, table.axes, table.raised, table.bends, rotation, by_first, by_second, turn_var)
    joint_angles(frames, points_cov, table.pairs, joints, determined, limits, out)
    for s in range(rotation.shape[0]):
        if turn_var[s] > limits[1] * limits[1]:
            rotation[s] = np.nan


@kernel()
def joint_angles(frames, points_cov, pairs, joints, determined, limits, out):
    """All angles, standard deviations and reasons.

    `limits`: sine below which a joint is locked, and the standard deviation from which an angle is not given.
    """
    rotation, by_first, by_second, turn_var = frames
    joint_segments, sequence, mirrored, sign, ground = joints
    angles, sigmas, reasons, weights = out
    relative = np.empty((3, 3))
    axes = np.empty((3, 3))
    for q in range(joint_segments.shape[0]):
        parent, child = joint_segments[q, 0], joint_segments[q, 1]
        over = ground if parent < 0 else rotation[parent]
        angles[q] = np.nan
        sigmas[q] = np.nan
        weights[q] = 0.0
        if math.isnan(over[0, 0]) or math.isnan(rotation[child, 0, 0]):
            for a in range(3):
                reasons[q, a] = MISSING if determined[q, a] else NOT_DETERMINED
            continue
        for i in range(3):
            for j in range(3):
                relative[i, j] = dot(over[:, i], rotation[child, :, j])
        if mirrored[q]:
            for i in range(3):
                for j in range(3):
                    if (i == 2) != (j == 2):
                        relative[i, j] = -relative[i, j]
        lock = cardan(relative, sequence[q], angles[q], axes)
        free = lock > limits[0]
        rates = np.linalg.inv(axes) if free else np.linalg.pinv(axes)
        for a in range(3):
            for i in range(3):
                if mirrored[q] and i != 2:
                    rates[a, i] = -rates[a, i]
                rates[a, i] *= sign[q, a]
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
            reasons[q, a] = _reason(determined[q, a], free or a == 1, sigmas[q, a], turn, limits[1])
            if reasons[q, a] != DEFINED:
                angles[q, a] = np.nan
                sigmas[q, a] = np.nan


@kernel()
def cardan(r, sequence, angles, axes):
    """Three angles of a rotation (3, 3), the axes (3, 3 columns) they turn about in parent axes, and sin of the lock angle."""
    axes[:] = 0.0
    if sequence == ZXY:
        a, b, c = math.atan2(-r[0, 1], r[1, 1]), math.asin(min(1.0, max(-1.0, r[2, 1]))), math.atan2(-r[2, 0], r[2, 2])
        axes[2, 0], axes[0, 1], axes[1, 1] = 1.0, math.cos(a), math.sin(a)
        last, lock = 1, math.hypot(r[2, 0], r[2, 2])
        b = math.atan2(r[2, 1], lock)
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


@kernel()
def _reason(determined, free, sigma, turn_var, limit):
    if not determined:
        return NOT_DETERMINED
    if not free:
        return GIMBAL_LOCK
    if sigma > limit:
        return STRAIGHT_LIMB if turn_var > 0.5 * sigma * sigma else UNCERTAIN
    return DEFINED


@kernel()
def unwrap(angles, last):
    """Move angles (J, 3) by whole turns to the nearest of their last values, which are then replaced."""
    for q in range(angles.shape[0]):
        for a in range(3):
            if not math.isnan(angles[q, a]):
                if not math.isnan(last[q, a]):
                    turns = round((last[q, a] - angles[q, a]) / (2.0 * math.pi))
                    angles[q, a] += 2.0 * math.pi * turns
                last[q, a] = angles[q, a]
