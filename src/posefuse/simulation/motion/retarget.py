"""BVH motions for our bodies.

Each segment's direction is kept exactly; its turn about itself starts, in the BVH's rest pose, with palms down or towards the
thighs and knees and elbows bending in the sagittal or horizontal plane, as in the T-poses and standing poses such files
rest in. Whatever the rest pose of the file, the correction is one constant rotation per segment. The pelvis's path is scaled
by the ratio of the leg lengths.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.formats.bvh import BvhData, read_bvh
from posefuse.simulation.body import SimulatedBody
from posefuse.simulation.body.angles import turn

from .posture import frame_along, lengths_m, unit_vectors
from .sampled import Sampled, on_floor
from .settings import RecordedSettings

# names (lower case, letters and digits only, maker's prefix dropped) a joint may have, best first; {s} is left/l
_NAMES = {
    "hips": ("hips", "pelvis", "hip", "root"),
    "head": ("head",),
    "thigh": ("{s}upleg", "{s}upperleg", "{s}thigh", "{s}hip"),
    "shank": ("{s}leg", "{s}lowleg", "{s}lowerleg", "{s}shin", "{s}calf", "{s}knee"),
    "foot": ("{s}foot", "{s}ankle"),
    "upper_arm": ("{s}arm", "{s}uparm", "{s}upperarm", "{s}shldr", "{s}shoulder"),
    "forearm": ("{s}forearm", "{s}lowarm", "{s}lowerarm", "{s}elbow"),
    "hand": ("{s}hand", "{s}wrist"),
}
_CHILD = {"thigh": "shank", "shank": "foot", "upper_arm": "forearm", "forearm": "hand"}
# a rest foot that points further down than this does not determine the forward direction
_FLAT_FOOT = 0.3


def retargeted(body: SimulatedBody, settings: RecordedSettings) -> Sampled:
    """A BVH file as a motion of this body; raises InputError naming the file and the joints that are missing."""
    data = read_bvh(Path(settings.file))
    if len(data) < 2:
        raise InputError(f"{settings.file}: expected at least 2 frames, got {len(data)}")
    joints = _joints(data, settings.file)
    rest = data.rest_positions()
    file_axes = _rest_axes(rest, joints, settings.file)
    rotation, position = data.world()
    if settings.heading_deg is None:
        world_from_file = _world_axes(file_axes[:, 1])
    else:
        world_from_file = _faced(rotation[0, joints["hips"]] @ file_axes, file_axes[:, 1], settings.heading_deg)
    frames = _segment_frames(rest, joints, file_axes, data)
    axes = {name: world_from_file @ rotation[:, joint] @ frame for name, (joint, frame) in frames.items()}
    legs = [joints["left_thigh"], joints["right_thigh"]]
    theirs = sum(np.linalg.norm(data.offset[joints[f"{s}_{p}"]]) for s in ("left", "right") for p in ("shank", "foot")) / 2
    path = position[:, legs].mean(axis=1) @ world_from_file.T * (sum(lengths_m(body, "left", "leg")) / theirs)
    path[:, :2] += np.array(settings.position_m or (0.0, 0.0)) - path[0, :2]
    times = np.arange(len(data)) * data.frame_s
    return on_floor(
        body,
        Sampled(
            t_s=times,
            centre_world=path,
            axes_world=axes,
            toes_up_rad=np.zeros((len(path), 2)),
            start_s=settings.start_s,
            loop=settings.loop,
        ),
        floor_known=False,
    )


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.split(":")[-1].lower())


def _joints(data: BvhData, file: str) -> dict[str, int]:
    """Place of the joint that moves each segment."""
    places = {_plain(name): j for j, name in reversed(list(enumerate(data.names)))}
    found: dict[str, int] = {}
    for role, names in _NAMES.items():
        sides = {f"{side}_{role}": (side, side[0]) for side in ("left", "right")} if "{s}" in names[0] else {role: ("",)}
        for key, prefixes in sides.items():
            wanted = [n.format(s=p) for n in names for p in prefixes]
            place = next((places[w] for w in wanted if w in places), None)
            if place is None:
                known = choices(n for n in data.names if not n.endswith("_end"))
                raise InputError(
                    f"{file}: joint for the {key.replace('_', ' ')}: expected one of {choices(wanted)}; there are: {known}"
                )
            found[key] = place
    for side in ("left", "right"):
        for role, child in _CHILD.items():
            _check_below(data, file, found[f"{side}_{role}"], found[f"{side}_{child}"])
    found["thorax"] = _common_ancestor(data, found["left_upper_arm"], found["right_upper_arm"])
    return found


def _ancestors(data: BvhData, joint: int) -> list[int]:
    line = [joint]
    while data.parent[line[-1]] >= 0:
        line.append(int(data.parent[line[-1]]))
    return line


def _check_below(data: BvhData, file: str, upper: int, lower: int) -> None:
    if upper not in _ancestors(data, lower)[1:]:
        raise InputError(
            f"{file}: broken hierarchy: expected joint {data.names[lower]!r} below {data.names[upper]!r}, "
            f"got it below {data.names[data.parent[lower]] if data.parent[lower] >= 0 else 'nothing'!r}"
        )


def _common_ancestor(data: BvhData, one: int, other: int) -> int:
    line = _ancestors(data, other)
    return next(joint for joint in _ancestors(data, one) if joint in line)


def _rest_axes(rest: Array, joints: dict[str, int], file: str) -> Array:
    """(3, 3) columns ahead, up, right of the resting figure in the file's axes; up is one of the file's own axes."""
    tall = rest[joints["head"]] - (rest[joints["left_foot"]] + rest[joints["right_foot"]]) / 2
    up = np.zeros(3)
    up[np.argmax(np.abs(tall))] = np.sign(tall[np.argmax(np.abs(tall))])
    right = rest[joints["right_thigh"]] - rest[joints["left_thigh"]]
    right = right - (right @ up) * up
    if np.linalg.norm(right) < 1e-9:
        raise InputError(f"{file}: broken hierarchy: expected the thighs side by side in the rest pose, got them in one place")
    right = unit_vectors(right)
    return np.stack([np.cross(up, right), up, right], axis=1)


def _world_axes(up: Array) -> Array:
    """World axes from the file's: its up becomes Z; a Y-up file's Z, or a Z-up file's X, becomes X."""
    ahead = np.roll(np.abs(up), 1)
    return np.stack([ahead, np.cross(up, ahead), up])


def _faced(first: Array, up: Array, heading_deg: float) -> Array:
    """World axes from the file's in which the first pose `first` (columns ahead, up, right) faces a heading."""
    level = _world_axes(up)
    ahead = level @ first[:, 0]
    return turn("z", np.deg2rad(heading_deg) - np.arctan2(ahead[1], ahead[0])) @ level


def _segment_frames(rest: Array, joints: dict[str, int], axes: Array, data: BvhData) -> dict[str, tuple[int, Array]]:
    """Each segment's joint, and the segment's axes (3, 3) in the rest pose of the file."""
    ahead, up, right = axes.T
    frames = {"pelvis": (joints["hips"], axes), "thorax": (joints["thorax"], axes), "head": (joints["head"], axes)}
    for side in ("left", "right"):
        thumb_ahead = ahead if side == "right" else -ahead
        for part in ("thigh", "shank", "upper_arm", "forearm"):
            joint, child = joints[f"{side}_{part}"], joints[f"{side}_{_CHILD[part]}"]
            along = unit_vectors(rest[joint] - rest[child])
            z = thumb_ahead if part == "forearm" else np.cross(ahead, along)
            frames[f"{side}_{part}"] = (joint, frame_along(along, z))
            if part == "forearm":
                frames[f"{side}_hand"] = (joints[f"{side}_hand"], frame_along(along, z))
        foot = joints[f"{side}_foot"]
        frames[f"{side}_foot"] = (foot, _foot_frame(rest, foot, data, ahead, up, right))
    return frames


def _foot_frame(rest: Array, foot: int, data: BvhData, ahead: Array, up: Array, right: Array) -> Array:
    """Level in the rest pose, towards the toes where the file has them."""
    toes = np.flatnonzero(data.parent == foot)
    along = rest[toes[0]] - rest[foot] if len(toes) else ahead
    flat = along - (along @ up) * up
    size = np.linalg.norm(along)
    if size < 1e-9 or np.linalg.norm(flat) < _FLAT_FOOT * size or flat @ ahead <= 0:
        return frame_along(up, right)
    return frame_along(up, np.cross(flat, up))
