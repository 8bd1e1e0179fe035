"""From what a 2D estimator marks to anatomical joint centres.

A landmark network is consistent, but what it calls a hip is not the centre of the hip joint. The difference is close to
constant in the body's own directions: each joint is moved by fixed lengths along directions built from the fused keypoints
themselves (trunk, limb above, limb below). Lengths are fitted elsewhere and come as a table; see `bench/fit_joint_centres.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from posefuse.core import ConfigError, PoseSequence, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.core.skeleton import pick_keypoints
from posefuse.files.settings import read_settings, settings

SIDES = ("left", "right")
JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
# knuckles of index and little finger lie about this far apart
_PALM_M = 0.07


@settings
class JointCentres:
    """Fitted offsets.

    Attributes:
        made_by: command and data of the fit, for people.
        offsets: joint (without its side) -> direction (see `directions`) -> metres.
    """

    made_by: str
    offsets: dict[str, dict[str, float]]


def read_joint_centres(path: Path) -> JointCentres:
    """Read a table; raises ConfigError naming the file, and the joint or direction that does not exist."""
    table = read_settings(path, JointCentres)
    known = directions(np.full((1, 1, 3), np.nan), Skeleton("none", ("nose",)), "left")
    for joint, offsets in table.offsets.items():
        if joint not in known:
            raise ConfigError(f"{path}: offsets: no joint {joint!r}; there are: {choices(known)}")
        for name in offsets:
            if name not in known[joint]:
                raise ConfigError(f"{path}: offsets.{joint}: no direction {name!r}; there are: {choices(known[joint])}")
    return table


def to_joint_centres(sequence: PoseSequence, table: JointCentres) -> PoseSequence:
    """The sequence with shoulders, elbows, wrists, hips, knees and ankles moved to their centres.

    A joint stays where it is at instants at which a direction it needs is unknown (a keypoint is missing, or two coincide).
    Covariances stay: the offsets are constants.
    """
    xyz = np.array(sequence.xyz_world)
    for side in SIDES:
        known = directions(sequence.xyz_world, sequence.skeleton, side)
        for joint, offsets in table.offsets.items():
            keypoint = f"{side}_{joint}"
            if keypoint not in sequence.skeleton.keypoints:
                continue
            move = sum((metres * known[joint][name] for name, metres in offsets.items()), np.zeros(3))
            xyz[..., sequence.skeleton.index(keypoint), :] += np.where(np.isfinite(move), move, 0.0)
    return replace(sequence, xyz_world=xyz)


def directions(xyz: Array, skeleton: Skeleton, side: str) -> Mapping[str, Mapping[str, Array]]:
    """Directions (..., 3) each joint of one side may be moved along, by joint and name, from keypoints (..., K, 3).

    Unit vectors: ``up`` (mid-hips to mid-shoulders), ``outward`` (away from the midline), ``forward`` of the pelvis for the
    hip and of the chest for the shoulder; limbs from proximal to distal (``upper_arm`` is called ``arm`` at the shoulder),
    ``foot`` heel to toe, ``hand`` wrist to knuckles; at the knee and ankle ``outward`` is the pelvis's, normal to the limb,
    and ``forward`` normal to both. Others: ``bend``, the difference of the limbs' directions below and above the joint,
    nothing when it is straight; ``sinking``, of the thigh's direction and the spine's downward one, nothing when standing;
    ``palm``, from little to index finger, about one long; ``raising``, outward as far as the arm points outward. NaN where
    keypoints are missing.
    """
    other = "left" if side == "right" else "right"

    def at(name: str) -> Array:
        return np.asarray(pick_keypoints(xyz, skeleton, [name])[..., 0, :])

    def limb(start: str, end: str) -> Array:
        return _unit(at(f"{side}_{end}") - at(f"{side}_{start}"))

    spine = at("neck") - at("mid_hip")
    upper_arm, forearm = limb("shoulder", "elbow"), limb("elbow", "wrist")
    thigh, shank, foot = limb("hip", "knee"), limb("knee", "ankle"), limb("heel", "foot_index")
    palm = at(f"{side}_index") - at(f"{side}_pinky")
    hand = _unit(at(f"{side}_pinky") + palm / 2 - at(f"{side}_wrist"))
    chest = _trunk(spine, at(f"{side}_shoulder") - at(f"{other}_shoulder"), side)
    pelvis = _trunk(spine, at(f"{side}_hip") - at(f"{other}_hip"), side)
    knee_out, ankle_out = _normal_to(thigh, pelvis["outward"]), _normal_to(shank, pelvis["outward"])
    return {
        "shoulder": {**chest, "arm": upper_arm, "raising": chest["outward"] * _cosine(upper_arm, chest["outward"])},
        "elbow": {"upper_arm": upper_arm, "forearm": forearm, "bend": forearm - upper_arm},
        "wrist": {"forearm": forearm, "hand": hand, "palm": palm / _PALM_M},
        "hip": {**pelvis, "thigh": thigh, "sinking": thigh + _unit(spine)},
        "knee": {"thigh": thigh, "bend": shank - thigh, "outward": knee_out, "forward": _ahead(-thigh, knee_out, side)},
        "ankle": {"shank": shank, "foot": foot, "outward": ankle_out, "forward": _ahead(-shank, ankle_out, side)},
    }


def _trunk(spine: Array, outward: Array, side: str) -> dict[str, Array]:
    out = _unit(outward)
    up = _normal_to(out, spine)
    return {"forward": _ahead(up, out, side), "up": up, "outward": out}


def _ahead(up: Array, outward: Array, side: str) -> Array:
    """Forward: left x up for the left side's outward, up x right for the right side's."""
    return np.asarray(np.cross(outward, up) if side == "left" else np.cross(up, outward))


def _cosine(one: Array, other: Array) -> Array:
    """(..., 1) of the angle between unit vectors."""
    return np.asarray((one * other).sum(axis=-1, keepdims=True))


def _normal_to(axis: Array, vector: Array) -> Array:
    """Unit part of `vector` normal to the unit vector `axis`."""
    return _unit(vector - _cosine(vector, axis) * axis)


def _unit(vector: Array) -> Array:
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector / np.where(length > 1e-6, length, np.nan))
