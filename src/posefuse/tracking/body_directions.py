"""Directions of the body at its joints, from keypoints; and how long the segments of people are, measured and before that."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.core.joint_centres import JOINT_DIRECTIONS, SEGMENT_ENDS, LengthPrior
from posefuse.core.skeleton import SIDES, pick_keypoints

# of the head, which has no joint centres: a line through them gives its tilt
HEAD = ("ear", "nose")
_MIDLINE = ("nose",)
# knuckles of index and little finger lie about this far apart
_PALM_M = 0.07
_MIDDLE = ("neck", "mid_hip", *_MIDLINE)
_OWN = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "heel", "foot_index", "index", "pinky", "knuckles")
_BETWEEN = {"knuckles": ("index", "pinky"), "mid_ear": ("ear", "other_ear")}
_POINTS = (*_MIDDLE, *_OWN, "other_shoulder", "other_hip", "ear", "other_ear", "mid_ear")
# the body's vectors, from one point to the other
_VECTORS = {
    "spine": ("mid_hip", "neck"),
    "across_chest": ("other_shoulder", "shoulder"),
    "across_pelvis": ("other_hip", "hip"),
    "upper_arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
    "hand": ("wrist", "knuckles"),
    "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"),
    "foot": ("heel", "foot_index"),
    "palm": ("pinky", "index"),
    "across_head": ("other_ear", "ear"),
    "to_nose": ("mid_ear", "nose"),
}
# (V, 2), in the order of which the kernels know
_ENDS = np.array([[_POINTS.index(end) for end in ends] for ends in _VECTORS.values()])
_COUNT = sum(len(names) for names in JOINT_DIRECTIONS.values())


def body_directions(xyz: Array, skeleton: Skeleton) -> Array:
    """(..., 2, D, 3) for the left and the right side, from keypoints (..., K, 3): the directions of `JOINT_DIRECTIONS` in a row.

    Unit vectors: ``up`` (mid-hips to mid-shoulders), ``outward`` (away from the midline), ``forward`` of the pelvis for the
    hip and of the chest for the shoulder; limbs from proximal to distal (``upper_arm`` is called ``arm`` at the shoulder),
    ``foot`` heel to toe, ``hand`` wrist to knuckles; at the knee and ankle ``outward`` is the pelvis's, normal to the limb,
    and ``forward`` normal to both. Others: ``bend``, the difference of the limbs' directions below and above the joint,
    nothing when it is straight; ``sinking``, of the thigh's direction and the spine's downward one, nothing when standing;
    ``palm``, from little to index finger, about one long; ``raising``, outward as far as the arm points outward;
    ``lowering``, normal to the arm and the chest's forward, down from an arm held out sideways: zero when it points down, one
    long when it is level; ``face``, from the ears to the nose, and ``crown``, normal to it and to the line of the ears, up.
    NaN where keypoints are missing.
    """
    from . import direction_kernels as kernels

    leading = np.shape(xyz)[:-2]
    given = np.array(xyz, np.float64).reshape(math.prod(leading), len(skeleton), 3)
    found = np.empty((len(given), len(SIDES), _COUNT, 3))
    kernels.directions(given, *_columns(skeleton), _ENDS, _PALM_M, found)
    return found.reshape(*leading, *found.shape[1:])


def keypoint_of(side: str, joint: str) -> str:
    """Name of the keypoint that is one of `JOINT_DIRECTIONS` on this side; those on the midline have none."""
    return joint if joint in _MIDLINE else f"{side}_{joint}"


@cache
def _columns(skeleton: Skeleton) -> tuple[Array, Array]:
    """(2, P) each: which two keypoints a point lies between; K where the skeleton lacks it."""
    found = np.full((2, 2, len(_POINTS)), len(skeleton))
    # what each keypoint weighs in each of the points
    weight = np.eye(len(skeleton))
    for s, (side, other) in enumerate((SIDES, SIDES[::-1])):
        for p, point in enumerate(_POINTS):
            names = [_named(part, side, other) for part in _BETWEEN.get(point, (point,))]
            parts = np.flatnonzero(pick_keypoints(weight.T, skeleton, names).sum(axis=0) > 0)
            if len(parts):
                found[:, s, p] = parts[0], parts[-1]
    return found[0], found[1]


def _named(point: str, side: str, other: str) -> str:
    if point in _MIDDLE:
        return point
    return f"{other}_{point.removeprefix('other_')}" if point.startswith("other_") else f"{side}_{point}"


# fewer time steps do not determine the lengths of the person's segments
_LEAST_TIME_STEPS = 10
_SEGMENT_ROWS = [[[end.format(side=side) for end in ends] for ends in SEGMENT_ENDS.values()] for side in SIDES]
_SEGMENT_POINTS = tuple(dict.fromkeys(end for side in _SEGMENT_ROWS for ends in side for end in ends))
_FROM, _TO = np.moveaxis(np.vectorize(_SEGMENT_POINTS.index)(np.array(_SEGMENT_ROWS)), -1, 0)
# adults of both sexes
_STATURE_M, _STATURE_SIGMA_M = 1.70, 0.10
# segments of `SEGMENT_ENDS`, between joint centres, as shares of stature. Means of de Leva 1996 (joint centres; J. Biomech.
# 29:1223) and Drillis and Contini 1966 (as in Winter, Biomechanics and Motor Control of Human Movement), rounded; shoulders and
# hips, which those give between landmarks of the bones, as in the simulator's bodies
_SHARE = {
    "upper_arm": 0.160, "forearm": 0.150, "thigh": 0.240, "shank": 0.247, "shoulders": 0.196, "hips": 0.107, "trunk": 0.292,
}  # fmt: skip
# standard deviation among people of the same stature, as a share of the length; what the sources disagree by included. The trunk
# ends at the shoulders, which rise by several centimetres with the arms
_SPREAD = {
    "upper_arm": 0.04, "forearm": 0.04, "thigh": 0.05, "shank": 0.05, "shoulders": 0.06, "hips": 0.08, "trunk": 0.08,
}  # fmt: skip


def lengths_at(xyz: Array, skeleton: Skeleton) -> Array:
    """(..., 2, S) metres of `SEGMENT_ENDS` on the left and the right side, from keypoints (..., K, 3); NaN where one is missing.

    What belongs to no side stands on both.
    """
    points = pick_keypoints(xyz, skeleton, _SEGMENT_POINTS)
    return np.asarray(np.linalg.norm(points[..., _TO, :] - points[..., _FROM, :], axis=-1))


def segment_lengths(xyz: Array, skeleton: Skeleton) -> Array:
    """(N, S) metres of people's `SEGMENT_ENDS` from keypoints (T, N, K, 3): medians over time and both sides.

    NaN for a segment seen in fewer than ten time steps.
    """
    metres = lengths_at(xyz, skeleton)
    out = np.full((xyz.shape[1], len(SEGMENT_ENDS)), np.nan)
    for n, s in np.ndindex(*out.shape):
        known = metres[:, n, :, s]
        known = known[np.isfinite(known)]
        if len(known) >= _LEAST_TIME_STEPS * len(SIDES):
            out[n, s] = np.median(known)
    return out


def usual_lengths() -> LengthPrior:
    """`SEGMENT_ENDS` of people in general: stature and what segments differ by at one stature."""
    share, spread = (np.array([values[segment] for segment in SEGMENT_ENDS]) for values in (_SHARE, _SPREAD))
    mean = _STATURE_M * share
    cov = np.outer(share, share) * _STATURE_SIGMA_M**2 + np.diag((spread * mean) ** 2)
    return LengthPrior(names=tuple(SEGMENT_ENDS), mean_m=mean, cov_m2=cov)
