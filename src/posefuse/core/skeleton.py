"""Named keypoints and how they hang together. Left and right are the subject's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np

from .arrays import Array, frozen
from .errors import ConfigError, choices

SIDES: tuple[Literal["left"], Literal["right"]] = ("left", "right")
# without side, and without the number of a point along a finger
_LIMB_PARTS = (
    (
        "shoulder", "elbow", "wrist", "hand_root", "thumb", "index", "middle", "ring", "pinky", "shoulder_marker",
        "elbow_lateral", "elbow_medial", "wrist_lateral", "wrist_medial",
    ),
    (
        "hip", "knee", "ankle", "heel", "foot_index", "big_toe", "small_toe", "asis", "psis", "knee_lateral", "knee_medial",
        "ankle_lateral", "ankle_medial", "fifth_metatarsal", "toe_marker",
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Skeleton:
    """Keypoint names in the order of axis K, and the bones between them.

    Attributes:
        name: e.g. ``blazepose33``.
        keypoints: snake_case names; `left_`/`right_` mark mirror pairs.
        bones: pairs of keypoint names, drawn and held to a constant length.
    """

    name: str
    keypoints: tuple[str, ...]
    bones: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "keypoints", tuple(self.keypoints))
        object.__setattr__(self, "bones", tuple((a, b) for a, b in self.bones))
        if len(set(self.keypoints)) != len(self.keypoints):
            raise ConfigError(f"skeleton {self.name}: keypoint names must be unique")
        for bone in self.bones:
            for keypoint in bone:
                self.index(keypoint)

    def __repr__(self) -> str:
        return f"Skeleton({self.name}, {len(self.keypoints)} keypoints, {len(self.bones)} bones)"

    def __len__(self) -> int:
        return len(self.keypoints)

    def __hash__(self) -> int:
        # asked for with every pose: equal skeletons have equal names
        return hash(self.name)

    def __reduce__(self) -> tuple[Any, ...]:
        """Between processes: one that everybody knows by its name; of all others one copy, however often they come."""
        if SKELETONS.get(self.name) == self:
            return _known, (self.name,)
        return _received, (self.name, self.keypoints, self.bones)

    def index(self, keypoint: str) -> int:
        """Place of a keypoint on axis K; raises ConfigError for an unknown one."""
        try:
            return self.keypoints.index(keypoint)
        except ValueError:
            raise ConfigError(f"skeleton {self.name}: no keypoint {keypoint!r}; there are: {choices(self.keypoints)}") from None

    def indices(self, keypoints: Sequence[str]) -> Array:
        """Places (n,) of several keypoints."""
        return np.array([self.index(keypoint) for keypoint in keypoints], dtype=np.intp)

    @cached_property
    def mirror(self) -> Array:
        """(K,) index of each keypoint's left/right counterpart (itself on the midline)."""
        places = [self.index(other) if (other := mirror_name(k)) in self.keypoints else i for i, k in enumerate(self.keypoints)]
        return frozen(places, np.intp, "mirror")

    @cached_property
    def limbs(self) -> tuple[tuple[Array, Array], ...]:
        """Keypoint indices (left, right) of what a detector confuses as a whole: arms with hands, then legs, if any."""
        pairs = []
        for parts in _LIMB_PARTS:
            left = [i for i, k in enumerate(self.keypoints) if k.startswith("left_") and k[5:].rstrip("0123456789") in parts]
            if left:
                pairs.append((frozen(left, np.intp, "limbs"), frozen(self.mirror[left], np.intp, "limbs")))
        return tuple(pairs)

    @cached_property
    def bone_indices(self) -> Array:
        """(B, 2) keypoint indices of the bones."""
        places = [[self.index(a), self.index(b)] for a, b in self.bones]
        return frozen(np.reshape(places, (-1, 2)), np.intp, "bone_indices")


def _known(name: str) -> Skeleton:
    return SKELETONS[name]


@lru_cache(maxsize=16)
def _received(name: str, keypoints: tuple[str, ...], bones: tuple[tuple[str, str], ...]) -> Skeleton:
    return Skeleton(name, keypoints, bones)


def swap_sides(plane: Array, wrong: Array, left: Array, right: Array) -> None:
    """Swap the keypoints `left` and `right` of plane[wrong], (..., K) or (..., K, D), in place."""
    rows = plane[wrong]
    rows[:, left], rows[:, right] = rows[:, right], rows[:, left]
    plane[wrong] = rows


def mirror_name(keypoint: str) -> str:
    """``left_hip`` <-> ``right_hip``; midline names stay."""
    if keypoint.startswith("left_"):
        return "right_" + keypoint[5:]
    if keypoint.startswith("right_"):
        return "left_" + keypoint[6:]
    return keypoint


def _both(pairs: Sequence[tuple[str, str]]) -> tuple[tuple[str, str], ...]:
    return tuple((f"{side}_{a}", f"{side}_{b}") for side in SIDES for a, b in pairs)


# segment -> its upper and its lower end
LIMB_ENDS = {
    "upper_arm": ("shoulder", "elbow"),
    "forearm": ("elbow", "wrist"),
    "thigh": ("hip", "knee"),
    "shank": ("knee", "ankle"),
}
_LIMBS = _both(tuple(LIMB_ENDS.values()))
_GIRDLES = (("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"))
_TRUNK = _both([("shoulder", "hip")])

BLAZEPOSE33 = Skeleton(
    "blazepose33",
    (
        "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
        "left_ear", "right_ear", "left_mouth", "right_mouth", "left_shoulder", "right_shoulder", "left_elbow",
        "right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index",
        "left_thumb", "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
        "left_heel", "right_heel", "left_foot_index", "right_foot_index",
    ),
    (*_GIRDLES, *_TRUNK, *_LIMBS, ("nose", "left_ear"), ("nose", "right_ear"), ("left_mouth", "right_mouth"))
    + _both([("wrist", "index"), ("wrist", "pinky"), ("wrist", "thumb"), ("index", "pinky")])
    + _both([("ankle", "heel"), ("heel", "foot_index"), ("ankle", "foot_index")]),
)  # fmt: skip

COCO17 = Skeleton(
    "coco17",
    (
        "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow",
        "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
        "right_ankle",
    ),
    (*_GIRDLES, *_TRUNK, *_LIMBS, ("nose", "left_ear"), ("nose", "right_ear")),
)  # fmt: skip

# what the simulator knows exactly: anatomical joint centres and surface points of one mesh
ANATOMICAL23 = Skeleton(
    "anatomical23",
    (*COCO17.keypoints, "left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe", "right_heel"),
    COCO17.bones + _both([("ankle", "heel"), ("heel", "big_toe"), ("ankle", "big_toe"), ("big_toe", "small_toe")]),
)

BODY_25 = Skeleton(
    "body_25",
    (
        "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
        "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye",
        "left_eye", "right_ear", "left_ear", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe",
        "right_small_toe", "right_heel",
    ),
    (*_GIRDLES, *_TRUNK, *_LIMBS, ("neck", "nose"), ("neck", "mid_hip"))
    + _both([("ankle", "heel"), ("heel", "big_toe"), ("big_toe", "small_toe")]),
)  # fmt: skip

BODY_25B = Skeleton(
    "body_25b",
    (
        "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow",
        "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
        "right_ankle", "neck", "head", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe",
        "right_small_toe", "right_heel",
    ),
    (*_GIRDLES, *_TRUNK, *_LIMBS, ("neck", "head"), ("nose", "neck"))
    + _both([("ankle", "heel"), ("heel", "big_toe"), ("big_toe", "small_toe")]),
)  # fmt: skip

HALPE_26 = Skeleton(
    "halpe_26",
    (
        *COCO17.keypoints, "head", "neck", "mid_hip", "left_big_toe", "right_big_toe", "left_small_toe", "right_small_toe",
        "left_heel", "right_heel",
    ),
    (*_GIRDLES, *_TRUNK, *_LIMBS, ("neck", "head"), ("nose", "neck"), ("neck", "mid_hip"))
    + _both([("ankle", "heel"), ("heel", "big_toe"), ("big_toe", "small_toe")]),
)  # fmt: skip

_FINGERS = ("thumb", "index", "middle", "ring", "pinky")
_FINGER_POINTS = tuple(f"{finger}{i}" for finger in _FINGERS for i in range(1, 5))
_HANDS = tuple(f"{side}_{point}" for side in SIDES for point in ("hand_root", *_FINGER_POINTS))
_FINGER_BONES = [(f"{finger}{i}", f"{finger}{i + 1}") for finger in _FINGERS for i in range(1, 4)]
# the 68 points of the face, from the subject's right ear along the chin: contour, brows, nose, eyes, outer and inner lips
_FACE = (
    *(f"right_jaw{i}" for i in range(8, 0, -1)), "chin", *(f"left_jaw{i}" for i in range(1, 9)),
    *(f"right_brow{i}" for i in range(5, 0, -1)), *(f"left_brow{i}" for i in range(1, 6)),
    *(f"nose_bridge{i}" for i in range(1, 5)), "right_nostril2", "right_nostril1", "nose_base", "left_nostril1", "left_nostril2",
    *(f"right_{point}" for point in ("eye_outer", "lid_upper2", "lid_upper1", "eye_inner", "lid_lower1", "lid_lower2")),
    *(f"left_{point}" for point in ("eye_inner", "lid_upper1", "lid_upper2", "eye_outer", "lid_lower2", "lid_lower1")),
    "right_mouth", "right_lip_upper2", "right_lip_upper1", "lip_upper", "left_lip_upper1", "left_lip_upper2",
    "left_mouth", "left_lip_lower2", "left_lip_lower1", "lip_lower", "right_lip_lower1", "right_lip_lower2",
    "right_inner_mouth", "right_inner_lip_upper", "inner_lip_upper", "left_inner_lip_upper",
    "left_inner_mouth", "left_inner_lip_lower", "inner_lip_lower", "right_inner_lip_lower",
)  # fmt: skip

COCO_WHOLEBODY_133 = Skeleton(
    "coco_wholebody_133",
    (*ANATOMICAL23.keypoints, *_FACE, *_HANDS),
    ANATOMICAL23.bones
    + _both([("wrist", "hand_root"), *(("hand_root", f"{finger}1") for finger in _FINGERS), *_FINGER_BONES])
    + _both([("index1", "middle1"), ("middle1", "ring1"), ("ring1", "pinky1")]),
)  # fmt: skip

HALPE_136 = Skeleton(
    "halpe_136",
    (*HALPE_26.keypoints, *_FACE, *_HANDS),
    HALPE_26.bones + tuple(bone for bone in COCO_WHOLEBODY_133.bones if bone not in ANATOMICAL23.bones),
)  # fmt: skip

# COCO-17 and 35 markers as laboratories place them (Gozlan et al. 2024, "OpenCapBench"), in the order of SynthPose's model card.
# "rshoulder" and "r_toe" have "marker" in their names here, as shoulders are joints and toes are tips; "r_calc" is the heel
SYNTHPOSE_52 = Skeleton(
    "synthpose_52",
    (
        *COCO17.keypoints, "sternum", "right_shoulder_marker", "left_shoulder_marker",
        *(
            f"{side}_{marker}"
            for marker in (
                "elbow_lateral", "elbow_medial", "wrist_lateral", "wrist_medial", "asis", "psis", "knee_lateral", "knee_medial",
                "ankle_lateral", "ankle_medial", "fifth_metatarsal", "toe_marker", "big_toe",
            )
            for side in ("right", "left")
        ),
        "left_heel", "right_heel", "c7", "l2", "t11", "t6",
    ),
    COCO17.bones + (("c7", "t6"), ("t6", "t11"), ("t11", "l2"), ("left_asis", "right_asis"), ("left_psis", "right_psis"))
    + _both([(f"{joint}_lateral", f"{joint}_medial") for joint in ("elbow", "wrist", "knee", "ankle")])
    + _both([("asis", "psis"), ("ankle", "heel"), ("heel", "big_toe"), ("big_toe", "fifth_metatarsal")]),
)  # fmt: skip

# the 14 joints of the paper's tables; neck and mid_hip are midpoints
PAPER14 = Skeleton(
    "paper14",
    (
        "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist", "mid_hip",
        "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle",
    ),
    (("neck", "mid_hip"), *_GIRDLES, *_LIMBS),
)  # fmt: skip

SKELETONS = {
    s.name: s
    for s in (
        BLAZEPOSE33, COCO17, ANATOMICAL23, BODY_25, BODY_25B, HALPE_26, SYNTHPOSE_52, COCO_WHOLEBODY_133, HALPE_136, PAPER14,
    )
}  # fmt: skip

_MIDPOINTS = {"neck": ("left_shoulder", "right_shoulder"), "mid_hip": ("left_hip", "right_hip")}
_SYNONYMS = {
    "left_foot_index": "left_big_toe",
    "right_foot_index": "right_big_toe",
    # the knuckles, which BlazePose names after their fingers
    "left_index1": "left_index",
    "right_index1": "right_index",
    "left_pinky1": "left_pinky",
    "right_pinky1": "right_pinky",
}


def pick_keypoints(xyz: Array, skeleton: Skeleton, wanted: Sequence[str]) -> Array:
    """Coordinates (..., n, d) of `wanted` keypoints out of (..., K, d).

    A keypoint the skeleton lacks is taken from its synonym (toe tip), else from the midpoint that defines it
    (neck, mid_hip), else NaN.
    """
    places = _places(skeleton, tuple(wanted))
    picked = np.take(xyz, places.first, axis=-2)
    if len(places.halves):
        one, other = places.ends
        picked[..., places.halves, :] = (xyz[..., one, :] + xyz[..., other, :]) / 2
    if len(places.missing):
        picked[..., places.missing, :] = np.nan
    return picked


class _Places(NamedTuple):
    """Where wanted keypoints are on axis K.

    Attributes:
        first: (n,) of each; any where there is none. halves: (h,) those that lie in the middle of two others. ends: (2, h) these.
        missing: (m,) those that the skeleton lacks.
    """

    first: Array
    halves: Array
    ends: Array
    missing: Array


@lru_cache(maxsize=256)
def _places(skeleton: Skeleton, wanted: tuple[str, ...]) -> _Places:
    have = {_SYNONYMS.get(k, k): i for i, k in enumerate(skeleton.keypoints)}
    pairs = []
    for keypoint in wanted:
        name = _SYNONYMS.get(keypoint, keypoint)
        pairs.append([have.get(end, -1) for end in ((name, name) if name in have else _MIDPOINTS.get(name, (name, name)))])
    ends = np.array(pairs, np.intp).reshape(-1, 2).T
    missing = (ends < 0).any(axis=0)
    halves = np.flatnonzero((ends[0] != ends[1]) & ~missing)
    return _Places(first=np.where(missing, 0, ends[0]), halves=halves, ends=ends[:, halves], missing=np.flatnonzero(missing))
