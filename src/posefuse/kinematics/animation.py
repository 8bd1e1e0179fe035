"""Segment frames to an animated skeleton of constant offsets, for BVH and glTF.

File axes: Y up, the rest pose stands upright with hanging arms and faces +Z. World (x, y, z) becomes file (y, z, x); a
segment's ISB axes (X anterior, Y proximal, Z right) become file (z, y, -x).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from posefuse.core import InputError, JointAngles, PoseSequence
from posefuse.core.arrays import Array
from posefuse.core.poses import evenly_spaced
from posefuse.core.skeleton import SIDES
from posefuse.formats.bvh import BvhData

from .definitions import JOINTS
from .side_clues import landmarks

FILE_FROM_WORLD = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
FILE_FROM_SEGMENT = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
# segment -> the one that carries it
PARENT = {joint.child: joint.parent for joint in JOINTS if joint.parent != "ground"}
# where a branch ends, as the mean of landmarks
_LIMB_END = {
    "upper_arm": ("elbow",), "forearm": ("wrist",), "hand": ("index", "pinky"), "thigh": ("knee",), "shank": ("ankle",),
    "foot": ("toe",),
}  # fmt: skip
_ENDS = {"head": ("nose",)} | {
    f"{side}_{segment}": tuple(f"{side}_{point}" for point in points) for side in SIDES for segment, points in _LIMB_END.items()
}
_LONGEST_GAP_S = 0.5


def animation_from_joints(sequence: PoseSequence, joints: JointAngles, person: int = 0) -> BvhData:
    """One person's motion in metres, with offsets that are medians over time, so bones keep their length.

    With segments of constant length (the whole-body fit) the motion read back is exactly that of `sequence`. Gaps up to half
    a second are bridged by the shortest turn. Until a person comes the first pose is held, and the last one at the end.
    Segments that were never seen are left out, with all that is attached to them.

    Args:
        sequence: the keypoints the joints were made from.
        joints: its frames. person: place on axis N.

    Raises:
        InputError: no pelvis, a longer gap (names segment and time), or time steps that are not evenly spaced.
    """
    if len(sequence) < 2 or len(evenly_spaced(sequence)) > len(sequence):
        raise InputError(f"animation: expected 2 or more evenly spaced time steps, got {len(sequence)}")
    world = joints.world_from_segment
    index = {name: s for s, name in enumerate(joints.segments)}
    names = ["pelvis"] + [name for name in PARENT if np.isfinite(world.xyz[:, person, index[name], 0]).any()]
    names = [name for name in names if _rooted(name, names)]
    ends = [n for n in names if n in _ENDS and n not in {PARENT.get(m) for m in names}]
    t_s, seen_s = joints.t_ns * 1e-9, _seen_s(joints, person)

    def filled(name: str) -> tuple[Array, Array]:
        frame = world[:, person, index[name]]
        turn, place = _filled(name, t_s, frame.matrix(), frame.xyz, seen_s)
        # the line from mid-hip to neck is rigid, so it turns about the hips
        return (turn, filled("pelvis")[1]) if name == "thorax" else (turn, place)

    points, pelvis = landmarks(sequence.xyz_world[:, person], sequence.skeleton), filled("pelvis")
    tips = {name: np.mean([points[p] for p in _ENDS[name]], axis=0) for name in ends}
    del points  # an hour of them takes as much memory as half of the rotations
    labels, parent, offset = ["pelvis"], [-1], [np.zeros(3)]
    rotation = [FILE_FROM_WORLD @ pelvis[0] @ FILE_FROM_SEGMENT.T]
    for name in names[1:]:
        over, own = filled(PARENT[name]), filled(name)
        rotation.append(FILE_FROM_SEGMENT @ np.swapaxes(over[0], -1, -2) @ own[0] @ FILE_FROM_SEGMENT.T)
        labels.append(name)
        parent.append(labels.index(PARENT[name]))
        offset.append(_median_in(over, own[1]))
    for name in ends:
        rotation.append(np.broadcast_to(np.eye(3), rotation[0].shape))
        labels.append(f"{name}_end")
        parent.append(labels.index(name))
        offset.append(_median_in(filled(name), tips[name]))
    still = [np.broadcast_to(one, pelvis[1].shape) for one in offset[1:]]
    return BvhData(
        names=tuple(labels),
        parent=np.array(parent),
        offset=np.array(offset),
        frame_s=float(np.diff(sequence.t_ns).mean()) * 1e-9,
        rotation=rotation,
        position=[pelvis[1] @ FILE_FROM_WORLD.T, *still],
    )


def _rooted(name: str, names: list[str]) -> bool:
    return name == "pelvis" or (PARENT[name] in names and _rooted(PARENT[name], names))


def _seen_s(joints: JointAngles, person: int) -> tuple[float, float] | None:
    """When the pelvis is seen first and last, session seconds; None: never."""
    known = np.isfinite(joints.world_from_segment.xyz[:, person, joints.segments.index("pelvis"), 0])
    t_s = joints.t_ns[known] * 1e-9
    return (float(t_s[0]), float(t_s[-1])) if len(t_s) else None


def _gap(name: str, known_s: Array, seen_s: tuple[float, float] | None) -> str | None:
    """What is wrong with a segment known at these times of a person who is there from `seen_s[0]` to `seen_s[1]`."""
    if seen_s is None or not len(known_s):
        return f"segment {name} was never seen"
    edges = np.concatenate([[min(seen_s[0], known_s[0])], known_s, [max(seen_s[1], known_s[-1])]])
    worst = int(np.argmax(np.diff(edges)))
    if edges[worst + 1] - edges[worst] <= _LONGEST_GAP_S:
        return None
    return (
        f"segment {name} is missing from {edges[worst]:.2f} to {edges[worst + 1]:.2f} s, longer than {_LONGEST_GAP_S} s; "
        "the whole-body fit fills such gaps"
    )


def _filled(name: str, t_s: Array, rotation: Array, origin: Array, seen_s: tuple[float, float] | None) -> tuple[Array, Array]:
    """Rotations and origins without gaps: bridged by the shortest turn, held at the ends."""
    known = np.flatnonzero(np.isfinite(rotation[:, 0, 0]))
    problem = _gap(name, t_s[known], seen_s)
    if problem:
        raise InputError(problem)
    if len(known) == len(t_s):
        return rotation, origin
    inside = np.clip(t_s, t_s[known[0]], t_s[known[-1]])
    places = np.stack([np.interp(inside, t_s[known], origin[known, i]) for i in range(3)], axis=-1)
    if len(known) == 1:
        return np.broadcast_to(rotation[known[0]], rotation.shape), places
    return Slerp(t_s[known], Rotation.from_matrix(rotation[known]))(inside).as_matrix(), places


def _median_in(frame: tuple[Array, Array], xyz: Array) -> Array:
    """Median place (3,) in a moving frame, in file axes."""
    seen = np.einsum("tij,ti->tj", frame[0], xyz - frame[1])
    return np.asarray(FILE_FROM_SEGMENT @ np.nanmedian(seen, axis=0))
