"""Recorded motions for our bodies: TRC markers and keypoints, posefuse results.

Each segment is oriented by its points. Needed: hips, knees, ankles, shoulders, elbows, wrists. Used where present: heels, toes,
nose, ears, eyes, knuckles of index and little finger. Limb directions are kept exactly; the turn about a limb comes from the
plane of the limb where it is bent and, smoothly blended, from the segment above where it is nearly straight. Pelvis, thorax,
head and feet are turned so that the body's own points, by the same rule, lie as the recorded ones do. Gaps in a track are closed
linearly in time.

The path of the pelvis is scaled by the ratio of the leg lengths about its start, so that the feet stay on the floor.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.core.skeleton import SIDES
from posefuse.evaluation.tracks import plain_name
from posefuse.formats.recording import read_recording
from posefuse.formats.trc import read_trc
from posefuse_sim.body import SEGMENTS, SimulatedBody
from posefuse_sim.body.anatomy import frame_along, normal_part, unit_vectors

from .posture import EASY_PRONATION_RAD, BodyPosture, arm_axes, lengths_m, on_floor, posture_between
from .settings import RecordedSettings

Points = dict[str, Array]
# times (T,) since the start -> postures
Motion = Callable[[Array], BodyPosture]


_NEEDED = tuple(f"{s}_{p}" for s in SIDES for p in ("hip", "knee", "ankle", "shoulder", "elbow", "wrist"))
_OPTIONAL = ("nose", *(f"{s}_{p}" for s in SIDES for p in ("ear", "eye", "heel", "big_toe", "small_toe", "index", "pinky")))
# between these sines of its bend a limb's plane takes over from the segment above
_BENT = (0.1, 0.35)


def from_trc(body: SimulatedBody, settings: RecordedSettings) -> Motion:
    """A TRC file as a motion of this body; raises InputError naming the file and the markers that are missing."""
    data = read_trc(Path(settings.file))
    return motion_from_points(body, data.t_s, _named(data.names, data.xyz_world, settings.file), settings)


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
    since_start_s = t_s - t_s[0]
    samples = on_floor(body, since_start_s, BodyPosture(path, axes, np.zeros((len(t_s), 2))))
    return lambda at_s: posture_between(since_start_s, samples, at_s)


_LEG = (("hip", "knee"), ("knee", "ankle"))


def _named(names: tuple[str, ...], xyz: Array, file: str) -> Points:
    """The used points out of all, gaps closed; raises InputError for needed ones that are not there."""
    places = {plain_name(name): i for i, name in reversed(list(enumerate(names)))}
    missing = [n for n in _NEEDED if n not in places]
    if missing:
        raise InputError(f"{file}: expected points for {choices(missing)}; there are: {choices(names)}")
    points = {}
    for name in (*_NEEDED, *_OPTIONAL):
        place = places.get(name)
        track = None if place is None else _closed(xyz[:, place])
        if track is not None:
            points[name] = track
        elif name in _NEEDED:
            raise InputError(f"{file}: {names[places[name]]}: expected at least one finite position, got none")
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
