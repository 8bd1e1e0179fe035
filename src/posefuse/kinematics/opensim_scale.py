"""A user's own OpenSim model scaled to a person: factors per body, the scaled model, and the joint centres on it.

Joints are found by the usual names of their coordinates (``hip_flexion_r``, ``knee_angle_r``, ``arm_flex_r``, ...), so any model
that has them will do. A body is scaled by how much longer the person's segment is than the distance between the model's own joint
centres in its default pose; pelvis and torso by widths and heights of their own; all other bodies by the mean.

Optional: needs ``pip install "posefuse[biomech]"``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array

from .body.model import BodyModel
from .opensim_path import opensim_library

SCALED_FILE, FACTORS_FILE, CENTRES_FILE = "scaled.osim", "scale_factors.xml", "joint_centres.xml"
# joint -> coordinates that models name it by
_COORDINATES = {
    "hip": ("hip_flexion",), "knee": ("knee_angle",), "ankle": ("ankle_angle",), "shoulder": ("arm_flex", "elv_angle"),
    "elbow": ("elbow_flex", "elbow_flexion"), "wrist": ("wrist_flex", "flexion"),
}  # fmt: skip
# segment -> (joint it begins at, joint it ends at)
_SPANS = {"thigh": ("hip", "knee"), "shank": ("knee", "ankle"), "upper_arm": ("shoulder", "elbow"), "forearm": ("elbow", "wrist")}
_SIDES = {"left": "l", "right": "r"}


@dataclass(frozen=True, eq=False)
class ScaleFactors:
    """Of one model and person.

    Attributes:
        bodies: name of a body -> (3,) factors along its own axes (X forward, Y up, Z right).
        lengths_m: name of a segment -> (the model's, the person's).
        joints: name of one of our joints -> (name of the body it is fixed to, (3,) place on the unscaled body).
    """

    bodies: Mapping[str, Array]
    lengths_m: Mapping[str, tuple[float, float]]
    joints: Mapping[str, tuple[str, Array]]


def scale_factors(model_path: Path, body: BodyModel) -> ScaleFactors:
    """Factors that give a model the person's segment lengths.

    Raises:
        DependencyError: the `opensim` package is missing. InputError: the file is no model, or has none of the usual joints.
    """
    osim = opensim_library()
    model, state = _opened(osim, model_path)
    joints = _joints(model)
    centres = {name: _xyz(joint.getChildFrame().getPositionInGround(state)) for name, joint in joints.items()}
    lengths = _lengths(centres, body)
    if not lengths:
        raise InputError(
            f"{model_path}: expected joints with coordinates of the usual names (hip_flexion_r, knee_angle_r, ...), found none"
        )
    ratio = {name: person / own for name, (own, person) in lengths.items()}
    mean = float(np.mean(list(ratio.values())))
    factors = {one.getName(): np.full(3, mean) for one in model.getBodySet()}
    tall = ratio.get("trunk", mean)
    if "right_hip" in joints:
        factors[_parent(joints["right_hip"])] = np.array([tall, tall, ratio.get("hips", mean)])
    if "right_shoulder" in joints:
        factors[_parent(joints["right_shoulder"])] = np.array([tall, tall, ratio.get("shoulders", mean)])
    for side in _SIDES:
        for segment, (begin, end) in _SPANS.items():
            key, last = f"{side}_{segment}", joints.get(f"{side}_{end}")
            if key not in ratio or last is None:
                continue
            for name in _chain(model, last, _child(joints[f"{side}_{begin}"])):
                factors[name] = np.full(3, ratio[key])
    placed = {name: (_parent(joint), _place(joint)) for name, joint in joints.items()}
    return ScaleFactors(factors, lengths, placed)


def write_scaled_model(model_path: Path, folder: Path, body: BodyModel) -> ScaleFactors:
    """Write ``scaled.osim``, ``scale_factors.xml`` (a ScaleSet for OpenSim's scale tool) and ``joint_centres.xml`` (a MarkerSet).

    The markers are named as the keypoints of our TRC, so that inverse kinematics can be run on the user's model.

    Args:
        model_path: the user's .osim; it is only read. folder: an existing folder. body: the person's skeleton.

    Raises:
        see `scale_factors`; InputError: a place that cannot be written to.
    """
    osim = opensim_library()
    if not folder.is_dir():
        raise InputError(f"{folder}: expected an existing folder for OpenSim's files")
    found = scale_factors(model_path, body)
    model, state = _opened(osim, model_path)
    scales = osim.ScaleSet()
    for name, factor in found.bodies.items():
        one = osim.Scale()
        one.setSegmentName(name)
        one.setScaleFactors(osim.Vec3(*factor))
        one.setApply(True)
        scales.cloneAndAppend(one)
    markers = osim.MarkerSet()
    for name, (at, place) in found.joints.items():
        marker = osim.Marker()
        marker.setName(name)
        marker.setParentFrameName(f"/bodyset/{at}")
        marker.set_location(osim.Vec3(*(place * found.bodies[at])))
        markers.cloneAndAppend(marker)
    model.scale(state, scales, True)
    scales.printToXML(str(folder / FACTORS_FILE))
    markers.printToXML(str(folder / CENTRES_FILE))
    model.printToXML(str(folder / SCALED_FILE))
    return found


def _opened(osim: Any, path: Path) -> tuple[Any, Any]:
    try:
        model = osim.Model(str(path))
        return model, model.initSystem()
    except RuntimeError as error:
        raise InputError(f"{path}: expected an OpenSim model ({' '.join(str(error).split())[:200]})") from None


def _joints(model: Any) -> dict[str, Any]:
    """Our joint name -> the model's joint."""
    by_coordinate = {}
    for joint in model.getJointSet():
        for i in range(joint.numCoordinates()):
            by_coordinate[joint.get_coordinates(i).getName()] = joint
    found = {}
    for side, letter in _SIDES.items():
        for name, coordinates in _COORDINATES.items():
            joint = next((by_coordinate[f"{c}_{letter}"] for c in coordinates if f"{c}_{letter}" in by_coordinate), None)
            if joint is not None:
                found[f"{side}_{name}"] = joint
    return found


def _lengths(centres: Mapping[str, Array], body: BodyModel) -> dict[str, tuple[float, float]]:
    """Segment -> metres of the model and of the person."""

    def apart(a: str, b: str) -> float | None:
        return float(np.linalg.norm(centres[a] - centres[b])) if a in centres and b in centres else None

    own = {f"{side}_{name}": apart(f"{side}_{a}", f"{side}_{b}") for side in _SIDES for name, (a, b) in _SPANS.items()}
    own["hips"], own["shoulders"] = apart("left_hip", "right_hip"), apart("left_shoulder", "right_shoulder")
    ends = [f"{side}_{joint}" for side in _SIDES for joint in ("hip", "shoulder")]
    if all(end in centres for end in ends):
        hips, neck = ((centres[f"left_{joint}"] + centres[f"right_{joint}"]) / 2 for joint in ("hip", "shoulder"))
        own["trunk"] = float(np.linalg.norm(neck - hips))
    person = {"hips": "pelvis"}
    return {
        name: (metres, body.lengths[person.get(name, name)].value_m)
        for name, metres in own.items()
        if metres and person.get(name, name) in body.lengths
    }


def _parent(joint: Any) -> str:
    return str(joint.getParentFrame().findBaseFrame().getName())


def _child(joint: Any) -> str:
    return str(joint.getChildFrame().findBaseFrame().getName())


def _chain(model: Any, joint: Any, first: str) -> list[str]:
    """Bodies from the one that carries `joint` back to `first`: forearms have two."""
    above = {_child(one): _parent(one) for one in model.getJointSet()}
    names = [_parent(joint)]
    while names[-1] != first and names[-1] in above:
        names.append(above[names[-1]])
    return names if names[-1] == first else [first]


def _place(joint: Any) -> Array:
    """(3,) where a joint begins on the body above it."""
    frame = joint.getParentFrame()
    return _xyz(frame.findTransformInBaseFrame().p())


def _xyz(vector: Any) -> Array:
    return np.array([vector.get(i) for i in range(3)])
