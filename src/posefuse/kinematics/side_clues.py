"""Is left really left? Three cues point forward only: the feet, the nose, and the direction in which knees and elbows bend."""

from __future__ import annotations

import numpy as np

from posefuse.core import InputError, PoseSequence, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import SIDES

from .definitions import LIMBS, POINTS, landmark_pairs

_FEWEST_VOTES = 20
_SURE = 0.8
_CLEAR_M = 0.04


def forward_votes(sequence: PoseSequence) -> Array:
    """(T, N, V) signs: +1 where a clue agrees that the left hip and shoulder are on the left, -1 against, 0 silent.

    Clues: each foot's toe and the nose lie in front; knees bend backward and elbows forward.
    """
    points = landmarks(sequence.xyz_world, sequence.skeleton)
    return _signs([*_clues(points, ("leg",)), *_bends(points, ("arm",))], _front(points, "hip"))


def facing_votes(sequence: PoseSequence) -> Array:
    """(2, T, N) sums of signs, for arms and for legs: positive where clues agree that the left one is on the left.

    Clues: feet and nose point forward, knees bend backward; forward is where shoulders (for arms) or hips (for legs) face.
    How elbows bend is not asked: a raised arm may bend either way.
    """
    points = landmarks(sequence.xyz_world, sequence.skeleton)
    clues = _clues(points, ("leg",))
    return np.stack([_signs(clues, _front(points, line)).sum(axis=-1) for line in ("shoulder", "hip")])


def _clues(points: dict[str, Array], limbs: tuple[str, ...]) -> list[Array]:
    """Vectors (T, N, 3) that point forward, as far as they are long: of feet, head and bent limbs."""
    feet = [points[f"{side}_toe"] - points[f"{side}_heel"] for side in SIDES]
    return [*feet, points["nose"] - (points["left_ear"] + points["right_ear"]) / 2, *_bends(points, limbs)]


def _bends(points: dict[str, Array], limbs: tuple[str, ...]) -> list[Array]:
    """How far each of these limbs is bent forward, (T, N, 3)."""
    bends = []
    for limb in LIMBS:
        if limb.name.endswith(limbs):
            upper, lower = points[limb.proximal] - points[limb.middle], points[limb.distal] - points[limb.middle]
            unit = upper / np.linalg.norm(upper, axis=-1, keepdims=True)
            bends.append(limb.bend * (lower - (lower * unit).sum(-1, keepdims=True) * unit))
    return bends


def _front(points: dict[str, Array], line: str) -> Array:
    """(T, N, 3) unit vectors: where the line from the left to the right hip or shoulder faces."""
    up = points["left_shoulder"] + points["right_shoulder"] - points["left_hip"] - points["right_hip"]
    front = np.cross(up, points[f"right_{line}"] - points[f"left_{line}"])
    return np.asarray(front / np.linalg.norm(front, axis=-1, keepdims=True))


def _signs(clues: list[Array], front: Array) -> Array:
    """(T, N, V) sign of each clue along the front; 0 where it is short or missing."""
    ahead = np.nan_to_num(np.stack([(clue * front).sum(-1) for clue in clues], axis=-1))
    return np.where(np.abs(ahead) > _CLEAR_M, np.sign(ahead), 0)


def check_sides(sequence: PoseSequence) -> None:
    """Raise InputError when the cues of a whole recording show that left and right are swapped."""
    votes = forward_votes(sequence)
    for n, person in enumerate(sequence.person_id):
        against, count = int((votes[:, n] < 0).sum()), int((votes[:, n] != 0).sum())
        if count >= _FEWEST_VOTES and against > _SURE * count:
            raise InputError(
                f"person {person}: left and right look swapped: in {100 * against // count} % of {count} clues feet, nose, knees "
                f"and elbows point behind the body of skeleton {sequence.skeleton.name}; swap them: left and right are the "
                "subject's own (a mirrored video or camera image gives this)"
            )


def landmarks(xyz: Array, skeleton: Skeleton) -> dict[str, Array]:
    """Each of `POINTS` (..., 3) of keypoints (..., K, 3); NaN where the skeleton or the recording lacks it."""
    pairs = landmark_pairs(skeleton)
    missing = np.full_like(xyz[..., 0, :], np.nan)
    return {
        name: (xyz[..., a, :] + xyz[..., b, :]) / 2 if min(a, b) >= 0 else missing
        for name, (a, b) in zip(POINTS, pairs.tolist(), strict=True)
    }
