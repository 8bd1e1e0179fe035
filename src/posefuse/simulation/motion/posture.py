"""The posture that every motion gives at each time, and the bone transforms that follow from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from posefuse.core.arrays import Array
from posefuse.simulation.body import SEGMENTS, SimulatedBody

_SIDES = {"left": "L", "right": "R"}
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
    """world_from_bone (T, B, 4, 4) of a posture."""
    turn = {name: posture.axes_world[name] @ _rest_axes(body, name).T for name in SEGMENTS}
    bones = {"root": turn["pelvis"]}
    bones |= {bone: slerp(turn["pelvis"], turn["thorax"], part) for bone, part in _SPINE.items()}
    bones |= {bone: slerp(turn["thorax"], turn["head"], part) for bone, part in _NECK.items()}
    for i, (side, letter) in enumerate(_SIDES.items()):
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


def slerp(first: Array, second: Array, part: float) -> Array:
    """Rotations (T, 3, 3) that have made `part` of the way from `first` to `second`, along the shortest turn."""
    step = Rotation.from_matrix(np.swapaxes(first, -1, -2) @ second).as_rotvec() * part
    return np.asarray(first @ Rotation.from_rotvec(step).as_matrix())


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
