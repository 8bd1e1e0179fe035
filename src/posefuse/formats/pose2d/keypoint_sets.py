"""Which keypoint set other tools' points are: by how many there are, or by what they are called."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from posefuse.core import SKELETONS, InputError, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.errors import choices

# OpenPose's COCO order: nose, neck, right arm, left arm, right leg, left leg, eyes, ears; places of COCO-17's keypoints in it
_COCO17_IN_COCO18 = (0, 15, 14, 17, 16, 5, 2, 6, 3, 7, 4, 11, 8, 12, 9, 13, 10)
_COCO18 = 18
# of BODY_25 and BODY_25B alike
BODY_POINTS = 25
COUNTS = {
    17: "coco17",
    18: "coco17",
    23: "anatomical23",
    25: "body_25",
    26: "halpe_26",
    33: "blazepose33",
    52: "synthpose_52",
    133: "coco_wholebody_133",
    136: "halpe_136",
}
_SIDES = {"l": "left", "left": "left", "r": "right", "right": "right"}
_NAMES = {
    "foot_index": "foot_index",
    "toe": "big_toe",
    "bigtoe": "big_toe",
    "smalltoe": "small_toe",
    "little_toe": "small_toe",
    "pelvis": "mid_hip",
    "midhip": "mid_hip",
    "hip_center": "mid_hip",
    "root": "mid_hip",
    "head_top": "head",
}


def skeleton_of_count(count: int, where: str) -> Skeleton:
    """The keypoint set of so many points; raises InputError for a number no set has."""
    if count not in COUNTS:
        known = ", ".join(str(number) for number in COUNTS)
        raise InputError(f"{where}: expected people of {known} keypoints, got {count}")
    return SKELETONS[COUNTS[count]]


def agreed_skeleton(skeleton: Skeleton | None, count: int, where: str) -> Skeleton:
    """The keypoint set of the people so far, or None, and of one more with so many points; raises InputError if they differ."""
    skeleton = skeleton or skeleton_of_count(count, where)
    if count != len(skeleton):
        raise InputError(f"{where}: expected {len(skeleton)} keypoints ({skeleton.name}), got {count}")
    return skeleton


def in_coco17_order(points: Array) -> Array:
    """COCO-17's points of OpenPose's 18 (the neck, a midpoint, is dropped); others as they are."""
    return points[list(_COCO17_IN_COCO18)] if len(points) == _COCO18 else points


def skeleton_of_names(names: Sequence[str], tool: str, where: str) -> Skeleton:
    """A keypoint set of named points, which bear our names where they can be recognised.

    One of `SKELETONS` where all names are its own; else one called after the tool with the bones known of any set.

    Raises:
        InputError: two points with the same name.
    """
    ours = tuple(keypoint_name(name) for name in names)
    if len(set(ours)) != len(ours):
        twice = next(name for name in ours if ours.count(name) > 1)
        given = [name for name, own in zip(names, ours, strict=True) if own == twice]
        raise InputError(f"{where}: expected every keypoint once, got {choices(given)}, all of which mean {twice}")
    for skeleton in SKELETONS.values():
        if skeleton.keypoints == ours:
            return skeleton
    bones = dict.fromkeys(bone for skeleton in SKELETONS.values() for bone in skeleton.bones)
    return Skeleton(tool, ours, tuple(bone for bone in bones if bone[0] in ours and bone[1] in ours))


def keypoint_name(name: str) -> str:
    """``RKnee``, ``knee_r``, ``Right Knee`` and ``RIGHT_KNEE`` are ``right_knee``."""
    split = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name)
    words = [word for word in re.split(r"[^A-Za-z0-9]+", split.lower()) if word]
    # "leftknee": the side is not set apart
    if words and words[0] not in _SIDES:
        for side in ("left", "right"):
            if words[0].startswith(side):
                words = [side, words[0].removeprefix(side), *words[1:]]
                break
    side = next((_SIDES[word] for word in words if word in _SIDES), "")
    rest = "_".join(word for word in words if word not in _SIDES)
    rest = _NAMES.get(rest, rest)
    return f"{side}_{rest}" if side and rest else rest or name


def points_of(row: Sequence[float] | Array, where: str) -> Array:
    """(K, 3) of a flat list x, y, score, x, y, score ...; raises InputError for a list of another length."""
    flat = np.asarray(row, np.float64).ravel()
    if not len(flat) or len(flat) % 3:
        raise InputError(f"{where}: expected keypoints as x, y, score triples, got {len(flat)} numbers")
    return flat.reshape(-1, 3)
