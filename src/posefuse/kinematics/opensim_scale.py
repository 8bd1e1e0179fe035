"""A user's own OpenSim model scaled to a person, with markers where the keypoints sit on it, and its inverse kinematics.

Joints are found by the usual names of their coordinates (``hip_flexion_r``, ``knee_angle_r``, ``arm_flex_r``, ...), so any model
that has them will do. A body is scaled by how much longer the person's segment is than the distance between the model's own joint
centres in its default pose; pelvis and torso by widths and heights of their own; all other bodies by the mean.

Markers are the joint centres, the points of the feet and, where the model can turn its head, those of the head. In the model's
neutral pose feet and head are aligned with the ground's axes, so they take the places that these points have on the person.

Optional: needs ``pip install "posefuse[biomech]"``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import DependencyError, InputError, PoseSequence
from posefuse.core.arrays import Array
from posefuse.core.skeleton import LIMB_ENDS, SIDES
from posefuse.formats.mot import longest_presence
from posefuse.formats.trc import TrcData, write_trc
from posefuse.foundation.parsing import one_line

from .body.model import BodyModel, segment_spans

SCALED_FILE, FACTORS_FILE, SCALED_MOTION_FILE, LOG_FILE = "scaled.osim", "scale_factors.xml", "scaled.mot", "opensim.log"
# of a radian squared against a metre squared of a marker: holds what hips and shoulders leave open, and moves no marker
_HELD_WEIGHT = 0.1
# joint -> coordinates that models name it by
_COORDINATES = {
    "hip": ("hip_flexion",), "knee": ("knee_angle",), "ankle": ("ankle_angle",), "shoulder": ("arm_flex", "elv_angle"),
    "elbow": ("elbow_flex", "elbow_flexion"), "wrist": ("wrist_flex", "flexion"),
}  # fmt: skip
# the last body below the ankle that the foot's points are fixed to: toes stay straight
_FOOT = ("subtalar_angle", "ankle_angle")
_NECK = ("neck_", "head_")
# hips and shoulders do not separate the tilt of the pelvis from the bend of the spine
_SPINE = ("lumbar_extension", "L5_S1_Flex_Ext")


def scale_factors(model_path: Path, body: BodyModel) -> dict[str, Array]:
    """By the name of a body, (3,) factors along its own axes (X forward, Y up, Z right) for the person's segment lengths.

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
    for joint, breadth in (("right_hip", "pelvis"), ("right_shoulder", "shoulders")):
        if joint in joints:
            factors[_parent(joints[joint])] = np.array([tall, tall, ratio.get(breadth, mean)])
    for side in SIDES:
        for segment, (begin, end) in LIMB_ENDS.items():
            key, last = f"{side}_{segment}", joints.get(f"{side}_{end}")
            if key not in ratio or last is None:
                continue
            for name in _chain(model, last, _child(joints[f"{side}_{begin}"])):
                factors[name] = np.full(3, ratio[key])
    return factors


def scaled_motion(model_path: Path, sequence: PoseSequence, folder: Path, person: int, body: BodyModel) -> None:
    """Scale the user's model to the person and run OpenSim's inverse kinematics on it.

    Writes ``scaled.osim`` (with our markers), ``scale_factors.xml`` (a ScaleSet for OpenSim's scale tool), ``scaled.trc`` (the
    markers' paths), ``scaled.mot`` (degrees and metres, under the model's own names) and OpenSim's log.

    Args:
        model_path: the user's .osim; it is only read. sequence: the recording. folder: an existing folder.
        person: place on axis N. body: the person's skeleton.

    Raises:
        see `scale_factors`; InputError: a place that cannot be written to, or OpenSim fails.
    """
    with logged_opensim(folder) as osim:
        names = write_scaled_model(model_path, folder, body)
        scaled = folder / SCALED_FILE
        held = [name for name in _SPINE if name in _by_coordinate(_opened(osim, scaled)[0])]
        _inverse_kinematics(osim, scaled, folder / SCALED_MOTION_FILE, names, sequence, person, held=held)


@contextmanager
def logged_opensim(folder: Path) -> Iterator[Any]:
    """The `opensim` package, which writes its log into this folder; its failures become an InputError with the log's last error.

    Raises:
        DependencyError: the `opensim` package is missing. InputError: no such folder, or OpenSim fails.
    """
    osim = opensim_library()
    if not folder.is_dir():
        raise InputError(f"{folder}: expected an existing folder for OpenSim's files")
    log = folder / LOG_FILE
    log.unlink(missing_ok=True)
    osim.Logger.setLevelString("Warn")
    osim.Logger.removeFileSink()
    osim.Logger.addFileSink(str(log))
    try:
        yield osim
    except RuntimeError as error:
        # not the file's name: a report that fails leaves no folder behind
        reasons = [line.partition("[error] ")[2] for line in log.read_text(errors="replace").splitlines() if "[error] " in line]
        raise InputError(f"{folder}: OpenSim failed ({one_line(reasons[-1] if reasons else error)})") from None
    finally:
        osim.Logger.removeFileSink()


def _inverse_kinematics(
    osim: Any,
    model: Path,
    motion: Path,
    names: Sequence[str],
    sequence: PoseSequence,
    person: int,
    held: Sequence[str],
) -> None:
    """Write the motion of a model with markers that are named like keypoints, and next to it the keypoints as TRC.

    Both hold the longest time in which the person is there (`longest_presence`), without the time steps of it that have half of
    the markers or fewer: OpenSim fails at the first that has none, and makes up most of the others.

    `held` names coordinates that stay near their default: what the keypoints do not determine.
    """
    t_s = sequence.t_ns * 1e-9
    rate_hz = (len(t_s) - 1) / float(np.ptp(t_s)) if len(t_s) > 1 else 1.0
    xyz = sequence.xyz_world[:, person, [sequence.skeleton.index(name) for name in names]]
    seen = np.isfinite(xyz).all(axis=-1).sum(axis=1)
    there = seen > seen.max() / 2
    rows = longest_presence(t_s, there)
    rows = rows[there[rows]]
    t_s, xyz = t_s[rows], xyz[rows]
    trc = motion.with_suffix(".trc")
    write_trc(trc, TrcData(names=tuple(names), t_s=t_s, xyz_world=xyz, rate_hz=rate_hz))
    tool = osim.InverseKinematicsTool()
    tool.setName("posefuse")
    tool.set_model_file(str(model))
    tool.setMarkerDataFileName(str(trc))
    tool.setStartTime(float(t_s[0]))
    tool.setEndTime(float(t_s[-1]))
    tool.setResultsDir(str(motion.parent))
    tool.setOutputMotionFileName(str(motion))
    tasks = tool.upd_IKTaskSet()
    for name in names:
        task = osim.IKMarkerTask()
        task.setName(name)
        task.setApply(True)
        task.setWeight(1.0)
        tasks.cloneAndAppend(task)
    for name in held:
        task = osim.IKCoordinateTask()
        task.setName(name)
        task.setValueType(osim.IKCoordinateTask.DefaultValue)
        task.setWeight(_HELD_WEIGHT)
        tasks.cloneAndAppend(task)
    tool.set_report_errors(False)
    with _quiet_output():
        done = tool.run()
    if not done:
        raise RuntimeError("the inverse kinematics tool did not finish")


@contextmanager
def _quiet_output() -> Iterator[None]:
    """Without the table of the model that OpenSim's C++ prints past its own log: stdout may be a program's JSON."""
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        with Path(os.devnull).open("wb") as nowhere:
            os.dup2(nowhere.fileno(), 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def opensim_library() -> Any:
    """The `opensim` package; raises DependencyError if it is missing."""
    loaded = "opensim" in sys.modules
    try:
        import opensim
    except ImportError as error:
        raise DependencyError(f'OpenSim is missing ({error}); install it with: pip install "posefuse[biomech]"') from None
    if not loaded:
        # by itself it writes opensim.log into the folder the program was started in
        opensim.Logger.removeFileSink()
    return opensim


def write_scaled_model(model_path: Path, folder: Path, body: BodyModel) -> list[str]:
    """Write ``scaled.osim`` and ``scale_factors.xml``; returns the names of the markers that were put into the model.

    Raises:
        see `scale_factors`.
    """
    osim = opensim_library()
    model, state = _opened(osim, model_path)
    scales = osim.ScaleSet()
    for name, factor in scale_factors(model_path, body).items():
        one = osim.Scale()
        one.setSegmentName(name)
        one.setScaleFactors(osim.Vec3(*factor))
        one.setApply(True)
        scales.cloneAndAppend(one)
    model.scale(state, scales, True)
    scales.printToXML(str(folder / FACTORS_FILE))
    markers = _markers(model, body)
    own = model.updMarkerSet()
    for name, (at, place) in markers.items():
        if own.contains(name):
            own.remove(own.getIndex(name))
        model.addMarker(osim.Marker(name, model.getBodySet().get(at), osim.Vec3(*place)))
    model.finalizeConnections()
    model.printToXML(str(folder / SCALED_FILE))
    return list(markers)


def _markers(model: Any, body: BodyModel) -> dict[str, tuple[str, Array]]:
    """Name of each keypoint that the model has a place for -> (the body it is fixed to, (3,) its place there)."""
    osim, state = opensim_library(), _neutral(model)
    keypoints = body.skeleton.keypoints
    joints = {name: joint for name, joint in _joints(model).items() if name in keypoints}
    markers = {name: (_parent(joint), _place(joint)) for name, joint in joints.items()}
    for node, (at, origin_ground) in _extremities(model, state, joints, body).items():
        on_node, frame = body.keypoint_node == body.node(node), model.getBodySet().get(at)
        for k, local in zip(body.keypoint[on_node], body.keypoint_local[on_node], strict=True):
            place = model.getGround().findStationLocationInAnotherFrame(state, osim.Vec3(*(origin_ground + local)), frame)
            markers.setdefault(keypoints[k], (at, _xyz(place)))
    return markers


def _neutral(model: Any) -> Any:
    """The state in which every turn is zero."""
    state = model.initSystem()
    rotational = 1
    for one in model.getCoordinateSet():
        if one.getMotionType() == rotational and not one.getLocked(state) and not one.isDependent(state):
            one.setValue(state, 0.0, False)
    model.realizePosition(state)
    return state


def _extremities(model: Any, state: Any, joints: Mapping[str, Any], body: BodyModel) -> dict[str, tuple[str, Array]]:
    """Node of the person's skeleton -> (the model's body, where the node's origin is in the ground in this state)."""
    centres = {name: _xyz(joint.getChildFrame().getPositionInGround(state)) for name, joint in joints.items()}
    by_coordinate = _by_coordinate(model)
    found: dict[str, tuple[str, Array]] = {}
    for side in SIDES:
        foot = _first(by_coordinate, _FOOT, side)
        if foot is not None and f"{side}_ankle" in centres:
            found[f"{side}_ankle"] = _child(foot), centres[f"{side}_ankle"]
    neck = next((joint for name, joint in by_coordinate.items() if name.startswith(_NECK)), None)
    nodes = [node.name for node in body.nodes]
    if neck is not None and "head" in nodes and {"left_shoulder", "right_shoulder"} <= set(centres):
        above = body.offset[body.node("head")]
        found["head"] = _child(neck), (centres["left_shoulder"] + centres["right_shoulder"]) / 2 + above
    return {node: place for node, place in found.items() if node in nodes}


def _opened(osim: Any, path: Path) -> tuple[Any, Any]:
    try:
        model = osim.Model(str(path))
        return model, model.initSystem()
    except RuntimeError as error:
        raise InputError(f"{path}: expected an OpenSim model ({one_line(error)})") from None


def _joints(model: Any) -> dict[str, Any]:
    """Our joint name -> the model's joint."""
    by_coordinate = _by_coordinate(model)
    found = {}
    for side in SIDES:
        for name, coordinates in _COORDINATES.items():
            if (joint := _first(by_coordinate, coordinates, side)) is not None:
                found[f"{side}_{name}"] = joint
    return found


def _first(by_coordinate: Mapping[str, Any], names: tuple[str, ...], side: str) -> Any:
    """The joint with the first of these coordinates on a side that there is, or None."""
    return next((by_coordinate[f"{name}_{side[0]}"] for name in names if f"{name}_{side[0]}" in by_coordinate), None)


def _by_coordinate(model: Any) -> dict[str, Any]:
    return {joint.get_coordinates(i).getName(): joint for joint in model.getJointSet() for i in range(joint.numCoordinates())}


def _lengths(centres: Mapping[str, Array], body: BodyModel) -> dict[str, tuple[float, float]]:
    """Segment -> metres of the model and of the person, of those that both have."""
    ends = {f"{side}_{joint}": np.full(3, np.nan) for side in SIDES for joint in _COORDINATES} | dict(centres)
    own = {name: float(np.linalg.norm(span)) for name, span in segment_spans(ends).items()}
    return {name: (own_m, body.lengths[name].value_m) for name, own_m in own.items() if own_m > 0 and name in body.lengths}


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
