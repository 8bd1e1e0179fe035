"""Directions of the body at its joints, from keypoints: both sides at once in few operations, fast enough for every pose."""

from __future__ import annotations

from functools import cache

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import pick_keypoints

SIDES = ("left", "right")
# joint -> directions it may be moved along, in the order of `body_directions`
JOINT_DIRECTIONS = {
    "shoulder": ("forward", "up", "outward", "arm", "raising"),
    "elbow": ("upper_arm", "forearm", "bend", "lowering"),
    "wrist": ("forearm", "hand", "palm"),
    "hip": ("forward", "up", "outward", "thigh", "sinking"),
    "knee": ("thigh", "bend", "outward", "forward"),
    "ankle": ("shank", "foot", "outward", "forward"),
}
# knuckles of index and little finger lie about this far apart
_PALM_M = 0.07
_MIDDLE = ("neck", "mid_hip")
_OWN = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "heel", "foot_index", "index", "pinky", "knuckles")
_BETWEEN = {"knuckles": ("index", "pinky")}
_POINTS = (*_MIDDLE, *_OWN, "other_shoulder", "other_hip")
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
}
_FROM, _TO = (np.array([_POINTS.index(ends[i]) for ends in _VECTORS.values()]) for i in (0, 1))


def body_directions(xyz: Array, skeleton: Skeleton) -> Array:
    """(..., 2, D, 3) for the left and the right side, from keypoints (..., K, 3): the directions of `JOINT_DIRECTIONS` in a row.

    Unit vectors: ``up`` (mid-hips to mid-shoulders), ``outward`` (away from the midline), ``forward`` of the pelvis for the
    hip and of the chest for the shoulder; limbs from proximal to distal (``upper_arm`` is called ``arm`` at the shoulder),
    ``foot`` heel to toe, ``hand`` wrist to knuckles; at the knee and ankle ``outward`` is the pelvis's, normal to the limb,
    and ``forward`` normal to both. Others: ``bend``, the difference of the limbs' directions below and above the joint,
    nothing when it is straight; ``sinking``, of the thigh's direction and the spine's downward one, nothing when standing;
    ``palm``, from little to index finger, about one long; ``raising``, outward as far as the arm points outward;
    ``lowering``, normal to the arm and the chest's forward, down from an arm held out sideways: nothing when it hangs, one
    long when it is level. NaN where keypoints are missing.
    """
    points = _points(xyz, skeleton)
    vectors = points[..., _TO, :] - points[..., _FROM, :]
    unit = dict(zip(_VECTORS, np.moveaxis(_unit(vectors), -2, 0), strict=True))
    spine, chest_out, pelvis_out, arm, forearm, hand, thigh, shank, foot, _ = unit.values()
    # the second of each pair normal to the first: up of chest and pelvis, outward of knee and ankle
    axes = np.stack([chest_out, pelvis_out, thigh, shank], axis=-2)
    others = np.stack([spine, spine, pelvis_out, pelvis_out], axis=-2)
    normal = _unit(others - (others * axes).sum(axis=-1, keepdims=True) * axes)
    chest_up, pelvis_up, knee_out, ankle_out = np.moveaxis(normal, -2, 0)
    ups = np.stack([chest_up, pelvis_up, -thigh, -shank], axis=-2)
    ahead = _ahead(ups, np.stack([chest_out, pelvis_out, knee_out, ankle_out], axis=-2))
    chest_ahead, pelvis_ahead, knee_ahead, ankle_ahead = np.moveaxis(ahead, -2, 0)
    outward, upward = ((arm * axis).sum(axis=-1, keepdims=True) for axis in (chest_out, chest_up))
    raising = chest_out * outward
    lowering = _ahead(chest_ahead[..., None, :], arm[..., None, :])[..., 0, :] * outward * (1 + upward)
    return np.stack(
        [
            chest_ahead, chest_up, chest_out, arm, raising,
            arm, forearm, forearm - arm, lowering,
            forearm, hand, vectors[..., -1, :] / _PALM_M,
            pelvis_ahead, pelvis_up, pelvis_out, thigh, thigh + spine,
            thigh, shank - thigh, knee_out, knee_ahead,
            shank, foot, ankle_out, ankle_ahead,
        ],
        axis=-2,
    )  # fmt: skip


def _points(xyz: Array, skeleton: Skeleton) -> Array:
    """(..., 2, P, 3) of `_POINTS` on each side, each the middle of two keypoints (or of one and the same)."""
    one, other = _columns(skeleton)
    known = np.concatenate([xyz, np.full_like(xyz[..., :1, :], np.nan)], axis=-2)
    return np.asarray((known[..., one, :] + known[..., other, :]) / 2)


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


def _ahead(up: Array, outward: Array) -> Array:
    """Forward (..., 2, n, 3): left x up for the left side's outward, up x right for the right side's."""
    x, y, z = np.moveaxis(outward, -1, 0)
    a, b, c = np.moveaxis(up, -1, 0)
    crossed = np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=-1)
    return np.asarray(crossed * np.array([1.0, -1.0])[:, None, None])


def _unit(vector: Array) -> Array:
    length = np.sqrt((vector * vector).sum(axis=-1, keepdims=True))
    return np.asarray(vector / np.where(length > 1e-6, length, np.nan))
