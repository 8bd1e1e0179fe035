"""Directions of the body at its joints, from keypoints."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.core.joint_centres import JOINT_DIRECTIONS
from posefuse.core.skeleton import pick_keypoints

SIDES = ("left", "right")
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
