"""Recorded motions for our bodies: BVH files, TRC markers and keypoints, posefuse results.

Of a BVH file each segment's direction is kept exactly; its turn about itself starts, in the BVH's rest pose, with palms down or
towards the thighs and knees and elbows bending in the sagittal or horizontal plane, as in the T-poses and standing poses such
files rest in. Whatever the rest pose of the file, the correction is one constant rotation per segment.

Of points (TRC, results) each segment is oriented by its points. Needed: hips, knees, ankles, shoulders, elbows, wrists. Used
where present: heels, toes, nose, ears, eyes, knuckles of index and little finger. Limb directions are kept exactly; the turn
about a limb comes from the plane of the limb where it is bent and, smoothly blended, from the segment above where it is nearly
straight. Pelvis, thorax, head and feet are turned so that the body's own points, by the same rule, lie as the recorded ones do.
Gaps in a track are closed linearly in time.

The path of the pelvis is scaled by the ratio of the leg lengths (points: about its start, so that the feet stay on the floor).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.core.skeleton import SIDES
from posefuse.formats.bvh import BvhData
from posefuse.formats.recording import read_recording
from posefuse.formats.trc import read_trc
from posefuse_sim.body import SEGMENTS, SimulatedBody
from posefuse_sim.body.anatomy import frame_along, normal_part, turn, unit_vectors

from .bvh import read_bvh
from .posture import (
    EASY_PRONATION_RAD,
    BodyPosture,
    arm_axes,
    lengths_m,
    on_floor,
    posture_between,
)
from .settings import RecordedSettings

# names (lower case, letters and digits only, maker's prefix dropped) a joint may have, best first; {s} is left/l
_NAMES = {
    "hips": ("hips", "pelvis", "hip", "root"),
    "head": ("head",),
    "thigh": ("{s}upleg", "{s}upperleg", "{s}thigh", "{s}hip"),
    "shank": ("{s}leg", "{s}lowleg", "{s}lowerleg", "{s}shin", "{s}shank", "{s}calf", "{s}knee"),
    "foot": ("{s}foot", "{s}ankle"),
    "upper_arm": ("{s}arm", "{s}uparm", "{s}upperarm", "{s}shldr", "{s}shoulder"),
    "forearm": ("{s}forearm", "{s}lowarm", "{s}lowerarm", "{s}elbow"),
    "hand": ("{s}hand", "{s}wrist", "{s}forearmend"),
}
_CHILD = {"thigh": "shank", "shank": "foot", "upper_arm": "forearm", "forearm": "hand"}
# a rest foot that points further down than this does not determine the forward direction
_FLAT_FOOT = 0.3
Points = dict[str, Array]
# times (T,) since the start -> postures
Motion = Callable[[Array], BodyPosture]


def retargeted(body: SimulatedBody, settings: RecordedSettings) -> Motion:
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
    return _played(body, np.arange(len(data)) * data.frame_s, path, axes, settings, floor_known=False)


def _played(
    body: SimulatedBody, t_s: Array, centre: Array, axes: Points, settings: RecordedSettings, *, floor_known: bool
) -> Motion:
    """The motion through poses at times (n,): the pelvis's path (n, 3), and axes (n, 3, 3) of the segments."""
    samples = on_floor(body, t_s, BodyPosture(centre, axes, np.zeros((len(t_s), 2))), floor_known)
    return lambda at_s: posture_between(t_s, samples, at_s + settings.start_s, settings.loop)


def _plain_joint(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.split(":")[-1].lower())


def _joints(data: BvhData, file: str) -> dict[str, int]:
    """Place of the joint that moves each segment."""
    places = {_plain_joint(name): j for j, name in reversed(list(enumerate(data.names)))}
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


_NEEDED = tuple(f"{s}_{p}" for s in SIDES for p in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist"))
_OPTIONAL = ("nose", *(f"{s}_{p}" for s in SIDES for p in ("ear", "eye", "heel", "big_toe", "small_toe", "index", "pinky")))
_SYNONYMS = {"toe": "bigtoe", "footindex": "bigtoe"}
# between these sines of its bend a limb's plane takes over from the segment above
_BENT = (0.1, 0.35)


def from_trc(body: SimulatedBody, settings: RecordedSettings) -> Motion:
    """A TRC file as a motion of this body; raises InputError naming the file and the markers that are missing."""
    data = read_trc(Path(settings.file))
    xyz = data.xyz_world if settings.up == "y" else data.xyz_world[..., [1, 2, 0]]
    return motion_from_points(body, data.t_s, _named(data.names, xyz, settings.file), settings)


def from_result(body: SimulatedBody, settings: RecordedSettings) -> Motion:
    """A posefuse result folder as a motion of this body; raises InputError for a person or keypoints it does not have."""
    poses = read_recording(Path(settings.file)).poses
    seen = np.isfinite(poses.xyz_world[..., 0]).sum(axis=(0, 2))
    if not len(seen) or not seen.any():
        raise InputError(f"{settings.file}: expected at least one person, the result has no person")
    if settings.person is not None and settings.person not in poses.person_id:
        raise InputError(f"{settings.file}: person: no person {settings.person}; there are: {choices(map(str, poses.person_id))}")
    place = int(np.argmax(seen)) if settings.person is None else int(np.flatnonzero(poses.person_id == settings.person)[0])
    points = _named(poses.skeleton.keypoints, poses.xyz_world[:, place], settings.file)
    return motion_from_points(body, (poses.t_ns - poses.t_ns[0]) * 1e-9, points, settings)


def motion_from_points(body: SimulatedBody, t_s: Array, points: Points, settings: RecordedSettings) -> Motion:
    """The motion of this body that follows keypoints, each (T, 3) in world metres."""
    if len(t_s) < 2:
        raise InputError(f"{settings.file}: expected at least 2 time steps, got {len(t_s)}")
    axes = _axes(body, points)
    theirs = np.mean([np.linalg.norm(points[f"{s}_{a}"] - points[f"{s}_{b}"], axis=-1) for s in SIDES for a, b in _LEG])
    path = _middle(points, "left_hip", "right_hip") * (sum(lengths_m(body, "left", "leg")) / (2 * theirs))
    start = path[0, :2] * (2 * theirs) / sum(lengths_m(body, "left", "leg"))
    path[:, :2] += (start if settings.position_m is None else np.array(settings.position_m)) - path[0, :2]
    return _played(body, t_s - t_s[0], path, axes, settings, floor_known=True)


_LEG = (("hip", "knee"), ("knee", "ankle"))


def _plain(name: str) -> str:
    text = re.sub(r"[^a-z0-9]", "", name.lower())
    side = next((s for s in SIDES if text.startswith(s)), None)
    part = text.removeprefix(side or "")
    if side is None and text[:1] in "lr" and text[1:] in _PLAIN_PARTS:
        side, part = ("left" if text[0] == "l" else "right"), text[1:]
    return (side or "") + _SYNONYMS.get(part, part)


_PLAIN_PARTS = {n.removeprefix("left_").replace("_", "") for n in (*_NEEDED, *_OPTIONAL) if n.startswith("left_")} | set(
    _SYNONYMS
)


def _named(names: tuple[str, ...], xyz: Array, file: str) -> Points:
    """The used points out of all, gaps closed; raises InputError for needed ones that are not there."""
    places = {_plain(name): i for i, name in reversed(list(enumerate(names)))}
    missing = [n for n in _NEEDED if n.replace("_", "") not in places]
    if missing:
        raise InputError(f"{file}: expected points for {choices(missing)}; there are: {choices(names)}")
    points = {}
    for name in (*_NEEDED, *_OPTIONAL):
        place = places.get(name.replace("_", ""))
        track = None if place is None else _closed(xyz[:, place])
        if track is not None:
            points[name] = track
        elif name in _NEEDED:
            raise InputError(f"{file}: {names[places[name.replace('_', '')]]}: expected at least one finite position, got none")
    return points


def _closed(track: Array) -> Array | None:
    seen = np.flatnonzero(np.isfinite(track).all(axis=-1))
    if not len(seen):
        return None
    return np.stack([np.interp(np.arange(len(track)), seen, track[seen, i]) for i in range(3)], axis=-1)


def _middle(points: Points, *names: str) -> Array:
    return np.asarray(np.mean([points[name] for name in names], axis=0))


def _axes(body: SimulatedBody, points: Points) -> Points:
    rest = {name: point[None] for name, point in body.points_rest.items()}
    trunk = {"pelvis": ("hip",), "thorax": ("shoulder",)}
    axes = {name: _turned(body, name, _trunk(points, *p), _trunk(rest, *p)) for name, p in trunk.items()}
    axes["head"] = _head(body, points, rest, axes["thorax"])
    for side in SIDES:
        axes |= _leg(body, points, rest, side, axes["pelvis"])
        axes |= _arm(body, points, side, axes["thorax"])
    return axes


def _turned(body: SimulatedBody, segment: str, now: Array, at_rest: Array) -> Array:
    """Segment axes when frames of its points went from `at_rest` (1, 3, 3) to `now` (T, 3, 3)."""
    return np.asarray(now @ np.swapaxes(at_rest, -1, -2) @ body.segment_axes[SEGMENTS.index(segment)])


def _trunk(points: Points, across: str) -> Array:
    up = _middle(points, "left_shoulder", "right_shoulder") - _middle(points, "left_hip", "right_hip")
    right = points[f"right_{across}"] - points[f"left_{across}"]
    return frame_along(up - np.sum(up * unit_vectors(right), axis=-1, keepdims=True) * unit_vectors(right), right)


def _head(body: SimulatedBody, points: Points, rest: Points, thorax: Array) -> Array:
    for part in ("ear", "eye"):
        if {"nose", f"left_{part}", f"right_{part}"} <= set(points):
            frames = []
            for p in (points, rest):
                across = p[f"right_{part}"] - p[f"left_{part}"]
                ahead = p["nose"] - _middle(p, f"left_{part}", f"right_{part}")
                frames.append(frame_along(np.cross(across, ahead), across))
            return _turned(body, "head", *frames)
    return thorax @ body.rest_rotation("thorax", "head")


def _blended(along: Array, above: Array, plane: Array, bend_sine: Array) -> Array:
    """Directions (T, 3): of the reference `above` where the limb is straight, of its plane's normal where it is bent."""
    part = np.clip((bend_sine - _BENT[0]) / (_BENT[1] - _BENT[0]), 0.0, 1.0)
    weight = (part**2 * (3 - 2 * part))[:, None]
    reference = normal_part(above, along)
    normal = plane / np.maximum(np.linalg.norm(plane, axis=-1, keepdims=True), 1e-12)
    return np.asarray((1 - weight) * reference + weight * normal)


def _leg(body: SimulatedBody, points: Points, rest: Points, side: str, pelvis: Array) -> Points:
    hip, knee, ankle = (points[f"{side}_{p}"] for p in ("hip", "knee", "ankle"))
    thigh, shank = unit_vectors(hip - knee), unit_vectors(knee - ankle)
    # of a knee bent backwards the normal looks to the right
    normal = np.cross(shank, thigh)
    sine = np.sum(normal * pelvis[..., 2], axis=-1).clip(0.0)
    axes = {
        f"{side}_thigh": frame_along(thigh, _blended(thigh, pelvis[..., 2], normal, sine)),
        f"{side}_shank": frame_along(shank, _blended(shank, pelvis[..., 2], normal, sine)),
    }
    name = f"{side}_foot"
    if {f"{side}_heel", f"{side}_big_toe"} <= set(points):
        toes = [f"{side}_big_toe"] + ([f"{side}_small_toe"] if f"{side}_small_toe" in points else [])
        frames = []
        for p in (points, rest):
            ahead, up = _middle(p, *toes) - p[f"{side}_heel"], p[f"{side}_ankle"] - p[f"{side}_heel"]
            frames.append(frame_along(np.cross(np.cross(ahead, up), ahead), np.cross(ahead, up)))
        axes[name] = _turned(body, name, *frames)
    else:
        axes[name] = axes[f"{side}_shank"]
    return axes


def _arm(body: SimulatedBody, points: Points, side: str, thorax: Array) -> Points:
    shoulder, elbow, wrist = (points[f"{side}_{p}"] for p in ("shoulder", "elbow", "wrist"))
    upper, lower = unit_vectors(shoulder - elbow), unit_vectors(elbow - wrist)
    normal = np.cross(upper, lower)
    sine = np.linalg.norm(normal, axis=-1)
    # the hinge axis an arm has that was lifted to where it is by the shortest way from hanging
    hanging = thorax[..., 1]
    lifted = np.cross(hanging, upper)
    cosine = np.sum(hanging * upper, axis=-1, keepdims=True)
    z = thorax[..., 2]
    above = z + np.cross(lifted, z) + np.cross(lifted, np.cross(lifted, z)) / np.maximum(1 + cosine, 1e-6)
    upper_arm = frame_along(upper, _blended(upper, above, normal, sine))
    if {f"{side}_index", f"{side}_pinky"} <= set(points):
        across = (points[f"{side}_index"] - points[f"{side}_pinky"]) * (1.0 if side == "right" else -1.0)
        hand = frame_along(wrist - _middle(points, f"{side}_index", f"{side}_pinky"), across)
        forearm = frame_along(lower, across)
    else:
        # the bend found and the exact direction differ where the limb is nearly straight
        bend = np.arctan2(sine, np.sum(upper * lower, axis=-1))
        forearm = frame_along(lower, arm_axes(body, side, upper_arm, bend, EASY_PRONATION_RAD)[f"{side}_forearm"][..., 2])
        hand = forearm @ body.rest_rotation(f"{side}_forearm", f"{side}_hand")
    return {f"{side}_upper_arm": upper_arm, f"{side}_forearm": forearm, f"{side}_hand": hand}
