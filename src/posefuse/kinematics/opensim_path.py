"""The same recording through OpenSim: a full-body model of the person's own lengths, its inverse kinematics, its .mot.

The `opensim` package carries no model, so one is built through its API from the skeleton of the whole-body fit: twelve kinds
of bodies, joints in the ISB sequences with OpenSim's usual coordinate names, and one marker per keypoint where that keypoint
sits on this person. So the model needs no scaling: it is made to measure.

Optional: needs ``pip install "posefuse[biomech]"``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import DependencyError, InputError, PoseSequence
from posefuse.core.arrays import Array
from posefuse.core.skeleton import SIDES
from posefuse.formats.mot import longest_presence
from posefuse.formats.trc import TrcData, write_trc
from posefuse.foundation.parsing import one_line

from .body.model import BodyModel, bodies_from_poses

MODEL_FILE, MOTION_FILE, LOG_FILE = "model.osim", "inverse_kinematics.mot", "opensim.log"
_MASS_KG = 75.0
# of a radian squared against a metre squared of a marker: holds what hips and shoulders leave open, and moves no marker
_HELD_WEIGHT = 0.1
_Z, _X, _Y = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class _Link:
    """A body, the joint it is attached to (`turns`: coordinate names and axes, in sequence), and its share of the mass."""

    body: str
    parent: str
    offset: str
    turns: tuple[tuple[str, tuple[float, float, float]], ...]
    share: float


def _minus(axis: tuple[float, float, float]) -> tuple[float, float, float]:
    return (-axis[0], -axis[1], -axis[2])


def _limbs(side: str, s: str) -> tuple[_Link, ...]:
    # the left side turns the other way about X and Y, so that adduction and internal rotation stay positive
    x, y = (_X, _Y) if s == "r" else (_minus(_X), _minus(_Y))
    hip = ((f"hip_flexion_{s}", _Z), (f"hip_adduction_{s}", x), (f"hip_rotation_{s}", y))
    ankle = ((f"ankle_angle_{s}", _Z), (f"subtalar_angle_{s}", x), (f"foot_rotation_{s}", y))
    shoulder = ((f"arm_flex_{s}", _Z), (f"arm_add_{s}", x), (f"arm_rot_{s}", y))
    wrist = ((f"pro_sup_{s}", y), (f"wrist_flex_{s}", _Z), (f"wrist_dev_{s}", x))
    return (
        _Link(f"femur_{s}", "pelvis", f"{side}_hip", hip, 0.1),
        _Link(f"tibia_{s}", f"femur_{s}", f"{side}_knee", ((f"knee_angle_{s}", _minus(_Z)),), 0.045),
        _Link(f"foot_{s}", f"tibia_{s}", f"{side}_ankle", ankle, 0.014),
        _Link(f"humerus_{s}", "torso", f"{side}_shoulder", shoulder, 0.027),
        _Link(f"radius_{s}", f"humerus_{s}", f"{side}_elbow", ((f"elbow_flex_{s}", _Z),), 0.016),
        _Link(f"hand_{s}", f"radius_{s}", f"{side}_wrist", wrist, 0.006),
    )


_LINKS = (
    _Link("torso", "pelvis", "", (("lumbar_bending", _X), ("lumbar_rotation", _Y)), 0.35),
    _Link("head", "torso", "head", (("neck_extension", _Z), ("neck_bending", _X), ("neck_rotation", _Y)), 0.08),
    *_limbs("left", "l"),
    *_limbs("right", "r"),
)
_BODY_OF_NODE = {"pelvis": "pelvis", "stretch": "torso", "head": "head"} | {
    f"{side}_{node}": f"{body}_{side[0]}"
    for side in SIDES
    for node, body in (
        ("shoulder", "humerus"), ("carrying", "radius"), ("pronation", "hand"), ("hand", "hand"), ("hip", "femur"),
        ("varus", "tibia"), ("ankle", "foot"),
    )
}  # fmt: skip


def opensim_motion(sequence: PoseSequence, folder: Path, person: int = 0, body: BodyModel | None = None) -> None:
    """Build the person's model, write the keypoints as TRC, and let OpenSim's inverse kinematics write the .mot.

    Args:
        sequence: the recording. person: place on axis N.
        folder: an existing folder; receives the model, the markers, the motion and OpenSim's log. The motion has degrees and
            metres, under the names of OpenSim's own models.
        body: the person's skeleton; estimated from the recording when not given.

    Raises:
        DependencyError: the `opensim` package is missing.
        InputError: the person has no skeleton, or OpenSim fails.
    """
    body = body or bodies_from_poses(sequence)[int(sequence.person_id[person])]
    with logged_opensim(folder) as osim:
        write_opensim_model(folder / MODEL_FILE, body)
        names = [body.skeleton.keypoints[k] for k in body.keypoint]
        inverse_kinematics(osim, folder / MODEL_FILE, folder / MOTION_FILE, names, sequence, person)


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


def inverse_kinematics(
    osim: Any,
    model: Path,
    motion: Path,
    names: Sequence[str],
    sequence: PoseSequence,
    person: int,
    held: Sequence[str] = (),
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


def write_opensim_model(path: Path, body: BodyModel) -> None:
    """Write a full-body .osim of the person's own segment lengths, with a marker per keypoint.

    Pelvis tilt and lumbar flexion are one degree of freedom here: hips and shoulders do not separate them.
    """
    osim = opensim_library()
    model = osim.Model()
    model.setName("posefuse")
    bodies: dict[str, Any] = {"pelvis": _body(osim, model, "pelvis", 0.15)}
    _add_root(osim, model, bodies["pelvis"])
    offset = _offsets(body)
    for link in _LINKS:
        if link.parent in bodies and (not link.offset or link.offset in offset):
            bodies[link.body] = _body(osim, model, link.body, link.share)
            place = osim.Vec3(*offset[link.offset]) if link.offset else osim.Vec3(0)
            joint = osim.CustomJoint(
                f"{link.body}_joint", bodies[link.parent], place, osim.Vec3(0), bodies[link.body], osim.Vec3(0), osim.Vec3(0),
                _transform(osim, link.turns),
            )  # fmt: skip
            model.addJoint(joint)
    for marker, at, place in _markers(body, offset):
        model.addMarker(osim.Marker(marker, bodies[at], osim.Vec3(*place)))
    model.finalizeConnections()
    model.initSystem()
    model.printToXML(str(path))


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


def _offsets(body: BodyModel) -> Mapping[str, Array]:
    """Origin of each child body in its parent's frame; the torso's frame sits at the hips, the tree's at the neck."""
    offset = {node.offset: body.offset[n] for n, node in enumerate(body.nodes) if node.offset}
    return {
        name: place + offset["neck"] if name == "head" or name.endswith("shoulder") else place for name, place in offset.items()
    }


def _markers(body: BodyModel, offset: Mapping[str, Array]) -> list[tuple[str, str, list[float]]]:
    markers = []
    for index, node, local in zip(body.keypoint, body.keypoint_node, body.keypoint_local, strict=True):
        name = body.nodes[node].name
        place = local + offset["neck"] if name == "stretch" else local
        markers.append((body.skeleton.keypoints[index], _BODY_OF_NODE[name], [float(v) for v in place]))
    return markers


def _body(osim: Any, model: Any, name: str, share: float) -> Any:
    mass = share * _MASS_KG
    body = osim.Body(name, mass, osim.Vec3(0), osim.Inertia(0.01 * mass, 0.01 * mass, 0.01 * mass))
    model.addBody(body)
    return body


def _add_root(osim: Any, model: Any, pelvis: Any) -> None:
    turns = (("pelvis_tilt", _Z), ("pelvis_list", _X), ("pelvis_rotation", _Y))
    moves = (("pelvis_tx", _X), ("pelvis_ty", _Y), ("pelvis_tz", _Z))
    joint = osim.CustomJoint(
        "ground_pelvis", model.getGround(), osim.Vec3(0), osim.Vec3(0), pelvis, osim.Vec3(0), osim.Vec3(0),
        _transform(osim, turns, moves),
    )  # fmt: skip
    model.addJoint(joint)


def _transform(osim: Any, turns: Any, moves: Any = ()) -> Any:
    """A spatial transform with one coordinate per axis; axes that are not used stay fixed."""
    transform = osim.SpatialTransform()
    axes = list(turns) + [(None, axis) for axis in _completing([axis for _, axis in turns])]
    axes += list(moves) or [(None, axis) for axis in (_X, _Y, _Z)]
    for place, (name, axis) in enumerate(axes):
        one = transform.updTransformAxis(place)
        one.setAxis(osim.Vec3(*axis))
        if name:
            names = osim.ArrayStr()
            names.append(name)
            one.setCoordinateNames(names)
            one.set_function(osim.LinearFunction(1.0, 0.0))
        else:
            one.set_function(osim.Constant(0.0))
    return transform


def _completing(axes: list[tuple[float, float, float]]) -> list[tuple[float, float, float]]:
    """Unit axes that make three independent ones of those given."""
    left = [axis for axis in (_Z, _X, _Y) if not any(np.allclose(np.abs(axis), np.abs(other)) for other in axes)]
    return left[: 3 - len(axes)]
