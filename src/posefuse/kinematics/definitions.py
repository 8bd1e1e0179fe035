"""What the segments and joints are: which points span each frame, and each joint's declared sequence.

Axes are those of the ISB (Wu & Cavanagh 1995; Wu et al. 2002, 2005): X anterior, Y proximal (superior), Z to the
subject's right, on both sides of the body. The paper's segment frames (Z along the segment, Y mediolateral) are a
fixed permutation of these: its (X, Y, Z) is our (X, -Z, Y).

A frame needs two vectors: the first is one of its axes exactly, the second fixes the turn about it. Both are differences
of points (or of midpoints of two points), so that errors propagate in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import SIDES

X, Y, Z = 0, 1, 2

POINTS = (
    "left_hip", "right_hip", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist",
    "right_wrist", "left_index", "right_index", "left_pinky", "right_pinky", "left_knee", "right_knee", "left_ankle",
    "right_ankle", "left_heel", "right_heel", "left_toe", "right_toe", "nose", "left_ear", "right_ear",
)  # fmt: skip

# angle of the nose below the horizontal through the ears for a level head: mean of the shapes of adults in
# `kinematics/skin` (sd 1.3 degrees)
NOSE_BELOW_RAD = np.radians(6.6)

# a landmark a skeleton does not name: the mean of two that it does, or one of another name
_STAND_INS = {
    "left_toe": (("left_big_toe", "left_small_toe"), ("left_big_toe",), ("left_foot_index",)),
    "right_toe": (("right_big_toe", "right_small_toe"), ("right_big_toe",), ("right_foot_index",)),
}
MIDPOINTS = {
    "mid_hip": ("left_hip", "right_hip"),
    "neck": ("left_shoulder", "right_shoulder"),
    "mid_ear": ("left_ear", "right_ear"),
    **{f"{side}_knuckles": (f"{side}_index", f"{side}_pinky") for side in SIDES},
}


@dataclass(frozen=True)
class Segment:
    """One body segment.

    Attributes:
        name: its name.
        origin: point or midpoint its frame sits at.
        first: (from, to, axis): this vector is that axis exactly.
        second: (from, to, axis): this vector, made normal to the first, is that axis.
        limb: place among `LIMBS` when the turn about the first axis comes from the plane of a limb, else -1.
        raised_rad: angle about Z by which X lies above the direction of these vectors.
    """

    name: str
    origin: str
    first: tuple[str, str, int]
    second: tuple[str, str, int]
    limb: int = -1
    raised_rad: float = 0.0

    @property
    def points(self) -> tuple[str, ...]:
        """The landmarks it needs, midpoints resolved."""
        names = (self.origin, *self.first[:2], *self.second[:2])
        return tuple(dict.fromkeys(part for name in names for part in MIDPOINTS.get(name, (name,))))


@dataclass(frozen=True, kw_only=True)
class Limb:
    """Two segments that share the normal of their plane as Z axis.

    Attributes:
        name: name. parent: segment the last good plane is carried with.
        proximal, middle, distal: its three points.
        bend: +1 where the lower segment bends forward (elbow), -1 backward (knee).
    """

    name: str
    parent: str
    proximal: str
    middle: str
    distal: str
    bend: int


@dataclass(frozen=True, kw_only=True)
class Joint:
    """One joint: child relative to parent. Where its angles are zero is in `docs/kinematics.md`.

    Attributes:
        name: its name.
        parent, child: segments; parent ``ground`` is the world (X forward = world x, Y up, Z right).
        sequence: axes of the three successive rotations, in parent, moving and child axes.
        angle_names: what each angle is called; positive as named.
        sign: what each angle of the sequence is multiplied by (left sides are mirrored across the sagittal plane before).
        determined: which of the three the keypoints determine when all segments are known.
    """

    name: str
    parent: str
    child: str
    angle_names: tuple[str, str, str]
    sequence: str = "ZXY"
    sign: tuple[int, int, int] = (1, 1, 1)
    determined: tuple[bool, bool, bool] = (True, True, True)

    @property
    def mirrored(self) -> bool:
        """Whether it is on the left side."""
        return self.name.startswith("left_")


LIMBS = (
    Limb(name="left_arm", parent="thorax", proximal="left_shoulder", middle="left_elbow", distal="left_wrist", bend=1),
    Limb(name="right_arm", parent="thorax", proximal="right_shoulder", middle="right_elbow", distal="right_wrist", bend=1),
    Limb(name="left_leg", parent="pelvis", proximal="left_hip", middle="left_knee", distal="left_ankle", bend=-1),
    Limb(name="right_leg", parent="pelvis", proximal="right_hip", middle="right_knee", distal="right_ankle", bend=-1),
)


def _side_segments(side: str, other_first: bool, arm: int, leg: int) -> tuple[Segment, ...]:
    s, e, w = f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist"
    h, k, a = f"{side}_hip", f"{side}_knee", f"{side}_ankle"
    index, pinky, heel, toe = f"{side}_index", f"{side}_pinky", f"{side}_heel", f"{side}_toe"
    # palms forward in the anatomical position: the index is on the outside
    across = (index, pinky) if other_first else (pinky, index)
    return (
        Segment(f"{side}_upper_arm", s, (e, s, Y), (e, w, X), arm),
        Segment(f"{side}_forearm", e, (w, e, Y), (e, s, X), arm),
        Segment(f"{side}_hand", w, (f"{side}_knuckles", w, Y), (*across, Z)),
        Segment(f"{side}_thigh", h, (k, h, Y), (a, k, X), leg),
        Segment(f"{side}_shank", k, (a, k, Y), (h, k, X), leg),
        Segment(f"{side}_foot", a, (heel, toe, X), (heel, a, Y)),
    )


SEGMENTS = (
    Segment("pelvis", "mid_hip", ("left_hip", "right_hip", Z), ("mid_hip", "neck", Y)),
    Segment("thorax", "neck", ("mid_hip", "neck", Y), ("left_shoulder", "right_shoulder", Z)),
    Segment("head", "mid_ear", ("left_ear", "right_ear", Z), ("mid_ear", "nose", X), raised_rad=NOSE_BELOW_RAD),
    *_side_segments("left", True, 0, 2),
    *_side_segments("right", False, 1, 3),
)


def _side_joints(side: str) -> tuple[Joint, ...]:
    ball = ("flexion", "adduction", "internal_rotation")
    upper_arm, forearm, thigh, shank = (f"{side}_{name}" for name in ("upper_arm", "forearm", "thigh", "shank"))
    return (
        Joint(
            name=f"{side}_shoulder",
            parent="thorax",
            child=upper_arm,
            sequence="YXY",
            angle_names=("plane_of_elevation", "elevation", "internal_rotation"),
        ),
        Joint(name=f"{side}_arm", parent="thorax", child=upper_arm, angle_names=ball),
        Joint(
            name=f"{side}_elbow",
            parent=upper_arm,
            child=forearm,
            angle_names=("flexion", "carrying", "pronation"),
            determined=(True, False, False),
        ),
        Joint(
            name=f"{side}_wrist",
            parent=forearm,
            child=f"{side}_hand",
            sequence="YZX",
            angle_names=("pronation", "flexion", "ulnar_deviation"),
        ),
        Joint(name=f"{side}_hip", parent="pelvis", child=thigh, angle_names=ball),
        Joint(
            name=f"{side}_knee",
            parent=thigh,
            child=shank,
            angle_names=ball,
            sign=(-1, 1, 1),
            determined=(True, False, False),
        ),
        Joint(
            name=f"{side}_ankle",
            parent=shank,
            child=f"{side}_foot",
            angle_names=("dorsiflexion", "inversion", "internal_rotation"),
        ),
    )


JOINTS = (
    Joint(
        name="pelvis",
        parent="ground",
        child="pelvis",
        sequence="YXZ",
        angle_names=("rotation_left", "obliquity_right_down", "tilt_forward"),
        sign=(1, 1, -1),
    ),
    Joint(
        name="trunk",
        parent="pelvis",
        child="thorax",
        angle_names=("flexion", "bend_right", "rotation_left"),
        sign=(-1, 1, 1),
        determined=(False, True, True),
    ),
    Joint(
        name="neck",
        parent="thorax",
        child="head",
        angle_names=("flexion", "bend_right", "rotation_left"),
        sign=(-1, 1, 1),
    ),
    *_side_joints("left"),
    *_side_joints("right"),
)

SEGMENT_NAMES = tuple(segment.name for segment in SEGMENTS)
JOINT_NAMES = tuple(joint.name for joint in JOINTS)
ANGLE_NAMES = tuple(joint.angle_names for joint in JOINTS)
SEQUENCES = ("ZXY", "YXY", "YXZ", "YZX")


def _sources(point: str, skeleton: Skeleton) -> tuple[str, ...]:
    """The one or two keypoints a landmark is the mean of; () when the skeleton cannot give it."""
    choices: tuple[tuple[str, ...], ...] = (*_STAND_INS.get(point, ()), (point,))
    for names in choices:
        if all(name in skeleton.keypoints for name in names):
            return names
    return ()


@cache
def landmark_pairs(skeleton: Skeleton) -> Array:
    """(P, 2) keypoint indices whose mean is each of `POINTS` (twice the same for one keypoint); -1 where there is none."""
    rows = []
    for point in POINTS:
        names = _sources(point, skeleton)
        rows.append([skeleton.index(names[0]), skeleton.index(names[-1])] if names else [-1, -1])
    return np.array(rows)


def undefined_segments(skeleton: Skeleton) -> set[str]:
    """Segments whose frame this skeleton cannot give, because it lacks a point."""
    lacking = {p for p in POINTS if not _sources(p, skeleton)}
    return {segment.name for segment in SEGMENTS if not lacking.isdisjoint(segment.points)}


def joints_without_points(skeleton: Skeleton) -> str:
    """Joints none of whose angles this skeleton can give, and the points it lacks, in one line; empty where it lacks none."""
    lost = undefined_segments(skeleton)
    joints = [joint.name for joint in JOINTS if joint.child in lost or joint.parent in lost]
    lacking = [point for point in POINTS if not _sources(point, skeleton)]
    return f"no angles of {', '.join(joints)}: {skeleton.name} has no {', '.join(lacking)}" if joints else ""
