"""Is left really left? Three cues point forward only: the feet, the nose, and the direction in which knees and elbows bend."""

from __future__ import annotations

import numpy as np

from posefuse.core import InputError, PoseSequence
from posefuse.core.arrays import Array

from .definitions import LIMBS, POINTS, landmark_pairs

SIDES = ("left", "right")

_FEWEST_VOTES = 20
_SURE = 0.8
_CLEAR_M = 0.04


def forward_votes(sequence: PoseSequence) -> Array:
    """(T, N, V) signs: +1 where a clue agrees that the left hip and shoulder are on the left, -1 against, 0 silent.

    Clues: each foot's toe and the nose lie in front; knees bend backward and elbows forward.
    """
    points = landmarks(sequence)
    right = points["right_hip"] - points["left_hip"]
    up = points["left_shoulder"] + points["right_shoulder"] - points["left_hip"] - points["right_hip"]
    front = np.cross(up, right)
    front /= np.linalg.norm(front, axis=-1, keepdims=True)
    clues = [points[f"{side}_toe"] - points[f"{side}_heel"] for side in ("left", "right")]
    clues.append(points["nose"] - (points["left_ear"] + points["right_ear"]) / 2)
    for limb in LIMBS:
        upper, lower = points[limb.proximal] - points[limb.middle], points[limb.distal] - points[limb.middle]
        unit = upper / np.linalg.norm(upper, axis=-1, keepdims=True)
        clues.append(limb.bend * (lower - (lower * unit).sum(-1, keepdims=True) * unit))
    ahead = np.stack([(clue * front).sum(-1) for clue in clues], axis=-1)
    return np.where(np.abs(np.nan_to_num(ahead)) > _CLEAR_M, np.sign(np.nan_to_num(ahead)), 0)


def check_sides(sequence: PoseSequence) -> None:
    """Raise InputError when the cues of a whole recording show that left and right are swapped."""
    votes = forward_votes(sequence)
    for n, person in enumerate(sequence.person_id):
        against, count = int((votes[:, n] < 0).sum()), int((votes[:, n] != 0).sum())
        if count >= _FEWEST_VOTES and against > _SURE * count:
            raise InputError(
                f"person {person}: left and right look swapped: in {100 * against // count} % of {count} clues feet, nose, knees "
                f"and elbows point behind the body of skeleton {sequence.skeleton.name}; expected the subject's own left and "
                "right (a mirrored video or camera image gives this); swap them, or set sides_checked to false"
            )


def landmarks(sequence: PoseSequence) -> dict[str, Array]:
    """Each of `POINTS` over time (T, N, 3); NaN where the skeleton or the recording lacks it."""
    pairs = landmark_pairs(sequence.skeleton)
    xyz = np.concatenate([sequence.xyz_world, np.full_like(sequence.xyz_world[:, :, :1], np.nan)], axis=2)
    points = (xyz[:, :, pairs[:, 0]] + xyz[:, :, pairs[:, 1]]) / 2
    return {name: points[:, :, i] for i, name in enumerate(POINTS)}
