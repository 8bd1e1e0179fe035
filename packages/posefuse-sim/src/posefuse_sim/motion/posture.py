"""The posture that every motion gives at each time, its two-bone limbs, and the bone transforms that follow from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from posefuse.core.arrays import Array
from posefuse_sim.body import SEGMENTS, SimulatedBody, rotation_of
from posefuse_sim.body.anatomy import SIDES, frame_of, normal_part, unit_vectors

# of a relaxed arm
EASY_PRONATION_RAD = np.deg2rad(85.0)
# a limb is never asked to be straighter than this, where its plane is lost
_STRAIGHTEST = 1 - 1e-6


def lengths_m(body: SimulatedBody, side: str, limb: str) -> tuple[float, float]:
    """Lengths of the upper and the lower segment of ``leg`` or ``arm``."""
    names = {"leg": ("hip", "knee", "ankle"), "arm": ("shoulder", "elbow", "wrist")}[limb]
    a, b, c = (body.points_rest[f"{side}_{name}"] for name in names)
    return float(np.linalg.norm(b - a)), float(np.linalg.norm(c - b))


def hip_offset(body: SimulatedBody, side: str) -> Array:
    """(3,) hip centre in pelvis axes, from the middle of both hip centres."""
    middle = (body.points_rest["left_hip"] + body.points_rest["right_hip"]) / 2
    return np.asarray(_rest_axes(body, "pelvis").T @ (body.points_rest[f"{side}_hip"] - middle))


def leg_axes(
    body: SimulatedBody, side: str, centre: Array, pelvis: Array, ankle: Array, foot: Array, *, ahead: Array | None = None
) -> dict[str, Array]:
    """Axes (T, 3, 3) of thigh, shank and foot that put the ankle (T, 3) where it is asked, from a pelvis at `centre` (T, 3).

    An ankle out of reach is met along the line to it. The knee bends towards `ahead` (T, 3); None: where the foot points.
    """
    hip = centre + pelvis @ hip_offset(body, side)
    knee_ahead = foot[..., 0] if ahead is None else ahead
    thigh, shank = _bent(hip, ankle, knee_ahead, lengths_m(body, side, "leg"), knee=True)
    return {f"{side}_thigh": thigh, f"{side}_shank": shank, f"{side}_foot": foot}


def bend_arm(shoulder: Array, wrist: Array, elbow_side: Array, lengths: tuple[float, float]) -> tuple[Array, Array]:
    """Axes (T, 3, 3) of upper arm and of a forearm turned with it (pronation 0); the elbow points towards `elbow_side`."""
    return _bent(shoulder, wrist, elbow_side, lengths, knee=False)


def _bent(start: Array, end: Array, bulge: Array, lengths: tuple[float, float], knee: bool) -> tuple[Array, Array]:
    upper, lower = lengths
    line = end - start
    distance = np.linalg.norm(line, axis=-1)
    along = line / distance[..., None]
    distance = np.clip(distance, abs(upper - lower) * 1.001, (upper + lower) * _STRAIGHTEST)
    aside = normal_part(bulge, along)
    cosine = (upper**2 + distance**2 - lower**2) / (2 * upper * distance)
    sine = np.sqrt(np.maximum(1 - cosine**2, 0.0))
    middle = upper * (cosine[..., None] * along + sine[..., None] * aside)
    y_upper = -middle / upper
    y_lower = unit_vectors(middle - distance[..., None] * along)
    # the knee bulges forward (anterior), the elbow backward; Z = X x Y with X anterior
    z = unit_vectors(np.cross(aside if knee else -aside, -along))
    return frame_of(y_upper, z), frame_of(y_lower, z)


def arm_axes(
    body: SimulatedBody, side: str, upper_arm: Array, flexion: Array | float, pronation: Array | float
) -> dict[str, Array]:
    """Upper arm, forearm and hand axes (T, 3, 3): an elbow angle, a pronation, and the wrist as at rest."""
    flexion = np.broadcast_to(flexion, upper_arm.shape[:-2])
    angles = np.stack(np.broadcast_arrays(flexion, 0.0, pronation), axis=-1)
    forearm = upper_arm @ rotation_of(f"{side}_elbow", angles)
    hand = forearm @ body.rest_rotation(f"{side}_forearm", f"{side}_hand")
    return {f"{side}_upper_arm": upper_arm, f"{side}_forearm": forearm, f"{side}_hand": hand}


# how much of the turn from pelvis to thorax, and from thorax to head, each bone in between has made
_SPINE = {"spine04": 0.25, "spine03": 0.5, "spine02": 0.8, "spine01": 1.0}
_NECK = {"neck01": 0.25, "neck02": 0.5, "neck03": 0.75, "head": 1.0}
_TOES = tuple(f"toe{i}-1" for i in range(1, 6))
# the shoulder girdle follows the raised arm: about 1 to 5 of its elevation (Inman et al. 1944, clavicle)
_GIRDLE_GAIN = 0.2


@dataclass(frozen=True, eq=False)
class BodyPosture:
    """Body postures over time.

    Attributes:
        centre_world: (T, 3) middle of the hip centres.
        axes_world: each of `SEGMENTS` -> (T, 3, 3) world_from_segment rotation.
        toes_up_rad: (T, 2) left and right toes bent up from the foot.
    """

    centre_world: Array
    axes_world: Mapping[str, Array]
    toes_up_rad: Array


def bones_of(body: SimulatedBody, posture: BodyPosture) -> Array:
    """How each bone moved from rest (T, B, 4, 4) for a posture."""
    turn = {name: posture.axes_world[name] @ _rest_axes(body, name).T for name in SEGMENTS}
    bones = {"root": turn["pelvis"]}
    bones |= {bone: slerp(turn["pelvis"], turn["thorax"], part) for bone, part in _SPINE.items()}
    bones |= {bone: slerp(turn["thorax"], turn["head"], part) for bone, part in _NECK.items()}
    for i, (side, letter) in enumerate(SIDES.items()):
        limb = {part: turn[f"{side}_{part}"] for part in ("upper_arm", "forearm", "hand", "thigh", "shank", "foot")}
        bones[f"clavicle.{letter}"] = _girdle(posture, turn["thorax"], side)
        bones[f"upperarm01.{letter}"] = limb["upper_arm"]
        bones[f"lowerarm01.{letter}"] = _half_twisted(body, side, limb["upper_arm"], limb["forearm"])
        bones[f"lowerarm02.{letter}"] = limb["forearm"]
        bones[f"wrist.{letter}"] = limb["hand"]
        bones[f"upperleg01.{letter}"] = limb["thigh"]
        bones[f"lowerleg01.{letter}"] = limb["shank"]
        bones[f"foot.{letter}"] = limb["foot"]
        foot = posture.axes_world[f"{side}_foot"]
        up = Rotation.from_rotvec(foot[..., :, 2] * posture.toes_up_rad[:, i, None]).as_matrix()
        bones |= {f"{toe}.{letter}": up @ limb["foot"] for toe in _TOES}
    return body.pose(bones, posture.centre_world)


def slerp(first: Array, second: Array, part: float | Array) -> Array:
    """Rotations (..., 3, 3) that have made `part` of the way from `first` to `second`, along the shortest turn."""
    step = Rotation.from_matrix((np.swapaxes(first, -1, -2) @ second).reshape(-1, 3, 3)).as_rotvec() * part
    return np.asarray(first @ Rotation.from_rotvec(step).as_matrix().reshape(first.shape))


def _rest_axes(body: SimulatedBody, segment: str) -> Array:
    return np.asarray(body.segment_axes[SEGMENTS.index(segment)])


def _girdle(posture: BodyPosture, thorax_turn: Array, side: str) -> Array:
    thorax = posture.axes_world["thorax"]
    outward = thorax[..., :, 2] * (1.0 if side == "right" else -1.0)
    raised = thorax[..., :, 1] - posture.axes_world[f"{side}_upper_arm"][..., :, 1]
    return np.asarray(Rotation.from_rotvec(_GIRDLE_GAIN * np.cross(outward, raised)).as_matrix() @ thorax_turn)


def _half_twisted(body: SimulatedBody, side: str, upper: Array, lower: Array) -> Array:
    """The elbow end of the forearm has made half the forearm's twist away from its rest twist, about the forearm's line."""
    line_rest = _rest_axes(body, f"{side}_forearm")[:, 1]
    relative = Rotation.from_matrix(np.swapaxes(upper, -1, -2) @ lower)
    quaternion = relative.as_quat(canonical=True)
    twist = 2 * np.arctan2(quaternion[..., :3] @ line_rest, quaternion[..., 3])
    return np.asarray(lower @ Rotation.from_rotvec(-0.5 * twist[..., None] * line_rest).as_matrix())


_SOLE_M = 0.05
_SOFT_S = 0.12
_BALL_ON_FLOOR_M = 0.045
_TOES_UP_MOST_RAD = np.deg2rad(65.0)


def posture_between(t_s: Array, samples: BodyPosture, at_s: Array) -> BodyPosture:
    """Postures at times (T,) between samples at times (n,): rotations along the shortest turn, the pelvis along a cubic spline.

    Args:
        t_s: increasing, n >= 2. at_s: the first and the last pose stay before and after them.
    """
    at = np.clip(at_s, t_s[0], t_s[-1])
    i = np.clip(np.searchsorted(t_s, at, side="right") - 1, 0, len(t_s) - 2)
    part = ((at - t_s[i]) / (t_s[i + 1] - t_s[i]))[:, None]
    axes = {name: slerp(turns[i], turns[i + 1], part) for name, turns in samples.axes_world.items()}
    toes = samples.toes_up_rad[i] + part * (samples.toes_up_rad[i + 1] - samples.toes_up_rad[i])
    return BodyPosture(CubicSpline(t_s, samples.centre_world)(at), axes, toes)


def on_floor(body: SimulatedBody, t_s: Array, motion: BodyPosture) -> BodyPosture:
    """The motion at times (n,) raised smoothly wherever a foot would be below the floor, toes flat under a raised heel."""
    low, balls = _foot_heights_m(body, motion)
    step_s = float(np.median(np.diff(t_s)))
    reach = max(1, round(_SOFT_S / step_s))
    need = maximum_filter1d(np.maximum(-low.min(axis=1), 0.0), 4 * reach + 1, mode="nearest")
    rise = gaussian_filter1d(need, reach / 2, mode="nearest", truncate=4.0)
    near = np.clip(1 - (balls + rise[:, None] - _BALL_ON_FLOOR_M) / _BALL_ON_FLOOR_M, 0.0, 1.0)
    pitch = np.stack([np.arcsin(np.clip(motion.axes_world[f"{side}_foot"][:, 2, 0], -1, 1)) for side in SIDES], axis=-1)
    toes = near * np.clip(-pitch, 0.0, _TOES_UP_MOST_RAD)
    return replace(motion, centre_world=motion.centre_world + np.outer(rise, [0.0, 0.0, 1.0]), toes_up_rad=toes)


def _foot_heights_m(body: SimulatedBody, motion: BodyPosture) -> tuple[Array, Array]:
    """Heights (n, 2), left and right, of the lowest point of the foot without its toes, and of the toe joints."""
    pose = body.segments(bones_of(body, motion))
    lowest, balls = [], []
    for side, letter in SIDES.items():
        place = SEGMENTS.index(f"{side}_foot")
        ball = np.mean([body.bone_centre[body.bone(f"toe{i}-1.{letter}")] for i in (1, 2)], axis=0)
        points = np.vstack([_sole_points(body, letter), ball])
        local = (points - body.segment_origin[place]) @ body.segment_axes[place]
        heights = pose.matrix()[:, place, 2] @ local.T + pose.xyz[:, place, 2:]
        lowest.append(heights[:, :-1].min(axis=1))
        balls.append(heights[:, -1])
    return np.stack(lowest, axis=-1), np.stack(balls, axis=-1)


def _sole_points(body: SimulatedBody, letter: str) -> Array:
    """(n, 3) corners at rest of the lower part of a foot without its toes."""
    share = np.where(body.bone_index == body.bone(f"foot.{letter}"), body.bone_weight, 0.0).sum(axis=1)
    points = body.vertices_rest[share > 0.5]
    points = points[points[:, 2] < points[:, 2].min() + _SOLE_M]
    return np.asarray(points[ConvexHull(points).vertices])
