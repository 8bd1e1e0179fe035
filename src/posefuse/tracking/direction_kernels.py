"""Directions of the body and moves to joint centres, compiled: the live output computes them for every pose."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

_LEAST_M = 1e-6
# rows of `ends` in `directions`
_SPINE, _CHEST, _PELVIS, _ARM, _FOREARM, _HAND, _THIGH, _SHANK, _FOOT, _PALM, _EARS, _NOSE = range(12)


@kernel()
def directions(xyz, one, other, ends, palm_m, out):
    """out (n, 2, D, 3) of keypoints xyz (n, K, 3); see `body_directions`.

    one, other (2, P): the two keypoints between which each side's points lie, K where there is none.
    ends (V, 2): the points that each vector goes from and to.
    """
    vectors, unit = np.empty((len(ends), 3)), np.empty((len(ends), 3))
    for n in range(len(xyz)):
        for side in range(2):
            for v in range(len(ends)):
                _vector(xyz[n], one[side], other[side], ends[v], vectors[v])
                unit[v] = vectors[v]
                _scaled_to_one(unit[v])
            _limbs(unit, out[n, side])
            _planes(unit, 1.0 if side == 0 else -1.0, out[n, side])
            _head(unit, 1.0 if side == 0 else -1.0, out[n, side])
            out[n, side, 11] = vectors[_PALM] / palm_m


@kernel()
def _limbs(unit, out):
    """The directions that limbs give by themselves."""
    out[2], out[14] = unit[_CHEST], unit[_PELVIS]
    out[3], out[5] = unit[_ARM], unit[_ARM]
    out[6], out[9] = unit[_FOREARM], unit[_FOREARM]
    out[7] = unit[_FOREARM] - unit[_ARM]
    out[10] = unit[_HAND]
    out[15], out[17] = unit[_THIGH], unit[_THIGH]
    out[16] = unit[_THIGH] + unit[_SPINE]
    out[18] = unit[_SHANK] - unit[_THIGH]
    out[21], out[22] = unit[_SHANK], unit[_FOOT]


@kernel()
def _planes(unit, sign, out):
    """Up, outward and forward of chest, pelvis, knee and ankle, and the chest's directions as changed by the arm."""
    _normal(unit[_SPINE], unit[_CHEST], out[1])
    _normal(unit[_SPINE], unit[_PELVIS], out[13])
    _normal(unit[_PELVIS], unit[_THIGH], out[19])
    _normal(unit[_PELVIS], unit[_SHANK], out[23])
    _cross(unit[_CHEST], out[1], sign, out[0])
    _cross(unit[_PELVIS], out[13], sign, out[12])
    _cross(out[19], unit[_THIGH], -sign, out[20])
    _cross(out[23], unit[_SHANK], -sign, out[24])
    outward, upward = _dot(unit[_ARM], unit[_CHEST]), _dot(unit[_ARM], out[1])
    out[4] = unit[_CHEST] * outward
    _cross(unit[_ARM], out[0], sign * outward * (1 + upward), out[8])


@kernel()
def _head(unit, sign, out):
    """Face, crown and outward of the ear; face and crown of the nose."""
    _normal(unit[_NOSE], unit[_EARS], out[25])
    _cross(out[25], unit[_EARS], sign, out[26])
    out[27] = unit[_EARS]
    out[28], out[29] = out[25], out[26]


@kernel()
def _vector(xyz, one, other, ends, out):
    for a in range(3):
        out[a] = _middle(xyz, one[ends[1]], other[ends[1]], a) - _middle(xyz, one[ends[0]], other[ends[0]], a)


@kernel()
def _middle(xyz, one, other, axis):
    return (xyz[one, axis] + xyz[other, axis]) / 2 if one < len(xyz) and other < len(xyz) else math.nan


@kernel()
def _dot(first, second):
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


@kernel()
def _scaled_to_one(vector):
    length = math.sqrt(_dot(vector, vector))
    for a in range(3):
        vector[a] = vector[a] / length if length > _LEAST_M else math.nan


@kernel()
def _normal(vector, axis, out):
    """The part of a vector that is normal to a unit axis, of length one."""
    along = _dot(vector, axis)
    for a in range(3):
        out[a] = vector[a] - along * axis[a]
    _scaled_to_one(out)


@kernel()
def _cross(first, second, factor, out):
    out[0] = factor * (first[1] * second[2] - first[2] * second[1])
    out[1] = factor * (first[2] * second[0] - first[0] * second[2])
    out[2] = factor * (first[0] * second[1] - first[1] * second[0])


@kernel()
def moves(known, metres, first, columns, out):
    """out (n, K, 3) of directions known (n, 2, D, 3) and metres (n, D); zero where a direction that counts is NaN.

    first (J + 1,): where each joint's directions begin. columns (2, J): where the joint is on axis K, K where it is not.
    """
    move = np.empty(3)
    out[:] = 0.0
    for n in range(len(known)):
        for side in range(2):
            for j in range(columns.shape[1]):
                if columns[side, j] >= out.shape[1]:
                    continue
                move[:] = 0.0
                for d in range(first[j], first[j + 1]):
                    if metres[n, d] != 0.0:
                        for a in range(3):
                            move[a] += known[n, side, d, a] * metres[n, d]
                if np.isfinite(move[0] + move[1] + move[2]):
                    out[n, columns[side, j]] = move
