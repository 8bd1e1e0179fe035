"""Messages about people, as pure functions: 2D and 3D poses and names, there and back, in layouts of `msg/posefuse_msgs`;

and in standard types of ROS transforms, poses, twists and joint states.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from posefuse.core import SE3, SKELETONS, Detections2D, JointAngles, Kind, MessageError, Pose3D, PosefuseError, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.joint_angles import angle_labels
from posefuse.health.camera_monitor import CameraState

from .bodies import JOINTS
from .types import message

Stages = Mapping[str, int]
# tf name of the world
WORLD = "world"
DETECTIONS_TYPE = "posefuse_msgs/msg/Detections2D"
POSE_TYPE = "posefuse_msgs/msg/Pose3D"
JOINT_ANGLES_TYPE = "posefuse_msgs/msg/JointAngles"
MAX_PEOPLE = 64
MAX_KEYPOINTS = 512
# 1000 frames a second for a year
MAX_FRAMES = 2**35
_NS = 1_000_000_000
# what a ROS stamp holds, 1901 to 2038
STAMPS_NS = range(-(2**31) * _NS, 2**31 * _NS)
_UPPER = np.triu_indices(3)
NAMES_TYPE = "std_msgs/msg/String"
# field of a message -> the array of the value, and its axes
Fields = Mapping[str, tuple[str, str]]
_DETECTION_FIELDS = {
    "xy_px": ("xy_img", "P K 2"),
    "score": ("score", "P K"),
    "sigma_px": ("sigma_px", "P K"),
    "box_px": ("box_img", "P 4"),
    "clothing_lab": ("clothing_lab", "P 3 3"),
    "depth_m": ("depth_m", "P K 2"),
}
_POSE_FIELDS = {
    "xyz_m": ("xyz_world", "N K 3"),
    "reprojection_px": ("reproj_px", "N K"),
    "views": ("n_views", "N K"),
    "kind": ("kind", "N K"),
}
# empty where nothing is known
_OPTIONAL = frozenset({"clothing_lab", "depth_m"})


def time_from_ns(t_ns: int) -> Any:
    """A `builtin_interfaces/Time`; raises MessageError outside the years it can hold (1901 to 2038)."""
    if t_ns not in STAMPS_NS:
        raise MessageError(f"time: a ROS stamp holds {STAMPS_NS[0]} to {STAMPS_NS[-1]} ns, got {t_ns}")
    return message("builtin_interfaces/msg/Time", sec=t_ns // _NS, nanosec=t_ns % _NS)


def ns_from_time(stamp: Any) -> int:
    """Nanoseconds of a `builtin_interfaces/Time`."""
    return int(stamp.sec) * _NS + int(stamp.nanosec)


def header(t_ns: int, frame_id: str) -> Any:
    """A `std_msgs/Header`."""
    return message("std_msgs/msg/Header", stamp=time_from_ns(t_ns), frame_id=frame_id)


def diagnostic_status(
    name: str, level: int, text: str, values: Mapping[str, str] = MappingProxyType({}), *, hardware_id: str | None = None
) -> Any:
    """`diagnostic_msgs/DiagnosticStatus`, one line of diagnostics.

    Args:
        name: e.g. ``camera cam02``. level: 0 ok, 1 warning, 2 error, 3 stale. text: what is the matter.
        values: figures to show, already with their units. hardware_id: None: the name.
    """
    return message(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=level,
        name=f"posefuse: {name}",
        message=text,
        hardware_id=name if hardware_id is None else hardware_id,
        values=[message("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()],
    )


def optical_frame(camera: str) -> str:
    """tf frame of a camera: x right, y down, z forward (REP-103)."""
    return f"{camera}_optical_frame"


def message_from_detections(detections: Detections2D, stages: Stages, state: CameraState | None = None) -> Any:
    """`posefuse_msgs/Detections2D` of one view; `state`: of its camera."""
    return message(
        DETECTIONS_TYPE,
        header=header(detections.t_ns, optical_frame(detections.camera)),
        camera=detections.camera,
        skeleton=detections.skeleton.name,
        keypoints=list(detections.skeleton.keypoints),
        people=len(detections),
        **_flat(detections, _DETECTION_FIELDS),
        stages=_stage_list(stages),
        captured=state.captured if state else 0,
        used=state.used if state else 0,
    )


def state_from_message(msg: Any) -> CameraState | None:
    """The counts of the camera in a `Detections2D` message, None where it has none; raises MessageError for impossible ones."""
    captured, used = int(msg.captured), int(msg.used)
    if not used <= captured <= MAX_FRAMES:
        raise MessageError(f"Detections2D message of {msg.camera}: {used} of {captured} frames used")
    if not captured:
        return None
    # a view has come, so the source runs
    return CameraState(camera=msg.camera, state="running", captured=captured, used=used, replaced=captured - used)


def detections_from_message(msg: Any) -> tuple[Detections2D, dict[str, int]]:
    """The view and its stages; raises MessageError for anything that does not fit."""
    where = "Detections2D message"
    skeleton = _skeleton(msg, where)
    people, k = int(msg.people), len(skeleton)
    if people > MAX_PEOPLE:
        raise MessageError(f"{where}: expected at most {MAX_PEOPLE} people, got {people}")
    if not msg.camera:
        raise MessageError(f"{where}: expected the camera's name, got an empty one")
    arrays = _shaped(msg, _DETECTION_FIELDS, {"P": people, "K": k}, where)
    score = arrays["score"]
    for name in ("sigma_px", "depth_m"):
        if (arrays.get(name, score) < 0).any():
            raise MessageError(f"{where} of {msg.camera}: {name}: expected values >= 0 or NaN")
    if not ((score >= 0) & (score <= 1)).all():
        raise MessageError(f"{where} of {msg.camera}: expected scores in 0..1")
    if (np.isnan(arrays["xy_img"]).any(axis=-1) & (score > 0)).any():
        raise MessageError(f"{where} of {msg.camera}: expected score 0 where a keypoint is NaN")
    view = Detections2D(camera=msg.camera, t_ns=ns_from_time(msg.header.stamp), skeleton=skeleton, **arrays)
    return view, _stages(msg)


def message_from_pose(pose: Pose3D, stages: Stages) -> Any:
    """`posefuse_msgs/Pose3D` of one time step."""
    return message(
        POSE_TYPE,
        header=header(pose.t_ns, WORLD),
        skeleton=pose.skeleton.name,
        keypoints=list(pose.skeleton.keypoints),
        person_id=pose.person_id,
        covariance_m2=pose.cov_world[..., _UPPER[0], _UPPER[1]].ravel(),
        **_flat(pose, _POSE_FIELDS),
        stages=_stage_list(stages),
    )


def pose_from_message(msg: Any) -> tuple[Pose3D, dict[str, int]]:
    """The people and their stages; raises MessageError for anything that does not fit."""
    where = "Pose3D message"
    skeleton = _skeleton(msg, where)
    n, k = len(msg.person_id), len(skeleton)
    if n > MAX_PEOPLE:
        raise MessageError(f"{where}: expected at most {MAX_PEOPLE} people, got {n}")
    fields = {**_POSE_FIELDS, "covariance_m2": ("cov_world", "N K 6")}
    arrays = _shaped(msg, fields, {"N": n, "K": k}, where)
    upper, kind = arrays["cov_world"], arrays["kind"]
    if kind.size and kind.max() > max(Kind):
        raise MessageError(f"{where}: kind: expected 0 to {max(Kind)}, got {kind.max()}")
    cov = np.empty((n, k, 3, 3))
    cov[..., _UPPER[0], _UPPER[1]] = upper
    cov[..., _UPPER[1], _UPPER[0]] = upper
    known = {**arrays, "cov_world": cov, "person_id": np.asarray(msg.person_id)}
    return Pose3D(t_ns=ns_from_time(msg.header.stamp), skeleton=skeleton, **known), _stages(msg)


def messages_from_joints(joints: JointAngles, t_ns: int) -> list[Any]:
    """`posefuse_msgs/JointAngles` of each person at the last time step of `joints`, stamped `t_ns`."""
    names = angle_labels(joints, "/")
    return [
        message(
            JOINT_ANGLES_TYPE,
            header=header(t_ns, WORLD),
            person_id=int(person),
            name=names,
            angle_rad=joints.angle_rad[-1, n].ravel(),
            sigma_rad=joints.sigma_rad[-1, n].ravel(),
        )
        for n, person in enumerate(joints.person_id)
    ]


def _stage_list(stages: Stages) -> list[Any]:
    return [message("posefuse_msgs/msg/Stage", name=name, stamp=time_from_ns(t_ns)) for name, t_ns in stages.items()]


def _stages(msg: Any) -> dict[str, int]:
    return {stage.name: ns_from_time(stage.stamp) for stage in msg.stages}


def _flat(value: Any, fields: Fields) -> dict[str, Array]:
    """The arrays of a value by the fields of its message; one that is not there is empty, and so are colours of no person."""
    arrays = {field: getattr(value, name) for field, (name, _) in fields.items()}
    if "clothing_lab" in arrays and np.isnan(arrays["clothing_lab"]).all():
        arrays["clothing_lab"] = None
    return {field: np.zeros(0, np.float32) if array is None else array.ravel() for field, array in arrays.items()}


def _shaped(msg: Any, fields: Fields, sizes: Mapping[str, int], where: str) -> dict[str, Array]:
    """The arrays of a message by their names in its value, without empty optional ones; MessageError where they do not fit."""
    arrays: dict[str, Array] = {}
    for field, (name, axes) in fields.items():
        array, shape = np.asarray(getattr(msg, field)), [sizes[axis] if axis in sizes else int(axis) for axis in axes.split()]
        if field in _OPTIONAL and not array.size:
            continue
        if array.size != int(np.prod(shape)):
            raise MessageError(f"{where}: {field} holds {array.size} numbers, expected {' x '.join(map(str, shape))}")
        if np.isinf(array).any():
            raise MessageError(f"{where}: {field}: expected finite values or NaN, got infinity")
        arrays[name] = array.reshape(shape)
    return arrays


def _skeleton(msg: Any, where: str) -> Skeleton:
    """The one we know by that name, or one made of the names sent (it then has no bones)."""
    keypoints = tuple(msg.keypoints)
    known = SKELETONS.get(msg.skeleton)
    if known is not None:
        if keypoints != known.keypoints:
            raise MessageError(f"{where}: skeleton {known.name} has {len(known)} keypoints in a fixed order, got others")
        return known
    if not 0 < len(keypoints) <= MAX_KEYPOINTS or not msg.skeleton:
        raise MessageError(f"{where}: expected a skeleton's name and 1 to {MAX_KEYPOINTS} keypoints, got {len(keypoints)}")
    try:
        return Skeleton(msg.skeleton, keypoints)
    except PosefuseError as error:
        raise MessageError(f"{where}: {error}") from None


def message_from_names(names: Mapping[int, str]) -> Any:
    """All names that are known."""
    return message(NAMES_TYPE, data=json.dumps({str(person): name for person, name in names.items()}, ensure_ascii=False))


def names_from_message(msg: Any) -> dict[int, str]:
    """As given to `message_from_names`; raises MessageError for anything else."""
    try:
        content = json.loads(msg.data)
        found = {int(person): name for person, name in content.items()}
    except (ValueError, AttributeError, RecursionError):
        raise MessageError("names message: expected a JSON object of names by person id") from None
    if not all(person >= 0 and isinstance(name, str) for person, name in found.items()):
        raise MessageError("names message: expected texts by ids from 0 on")
    return found


def transform(t_ns: int, parent: str, child: str, parent_from_child: SE3) -> Any:
    """`geometry_msgs/TransformStamped`: where `child` is in `parent`."""
    return _transform(header(t_ns, parent), child, parent_from_child.wxyz.tolist(), parent_from_child.xyz.tolist())


def transforms_of_children(t_ns: int, parent: str, names: Sequence[str], parent_from_child: SE3) -> list[Any]:
    """One transform per name that is not NaN; `parent_from_child` has one batch axis."""
    seen = np.asarray(np.isfinite(parent_from_child.wxyz).all(axis=-1) & np.isfinite(parent_from_child.xyz).all(axis=-1))
    poses = zip(names, parent_from_child.wxyz.tolist(), parent_from_child.xyz.tolist(), seen.tolist(), strict=True)
    of_all = header(t_ns, parent)
    return [_transform(of_all, name, wxyz, xyz) for name, wxyz, xyz, known in poses if known]


def _transform(stamped: Any, child: str, wxyz: list[float], xyz: list[float]) -> Any:
    return message(
        "geometry_msgs/msg/TransformStamped",
        header=stamped,
        child_frame_id=child,
        transform=message("geometry_msgs/msg/Transform", translation=vector(xyz), rotation=quaternion(wxyz)),
    )


def pose_stamped(t_ns: int, frame: str, pose: SE3) -> Any:
    """`geometry_msgs/PoseStamped`."""
    return message("geometry_msgs/msg/PoseStamped", header=header(t_ns, frame), pose=_pose(pose))


def pose_with_covariance(t_ns: int, frame: str, pose: SE3, cov: Array) -> Any:
    """`geometry_msgs/PoseWithCovarianceStamped`; cov (6, 6) of x, y, z and a turn about the frame's x, y, z."""
    inner = message("geometry_msgs/msg/PoseWithCovariance", pose=_pose(pose), covariance=np.asarray(cov, np.float64).ravel())
    return message("geometry_msgs/msg/PoseWithCovarianceStamped", header=header(t_ns, frame), pose=inner)


def twist_stamped(t_ns: int, frame: str, velocity: Array) -> Any:
    """`geometry_msgs/TwistStamped`; velocity (6,) in m/s and rad/s along and about the frame's axes."""
    return message("geometry_msgs/msg/TwistStamped", header=header(t_ns, frame), twist=twist(velocity))


def twist(velocity: Array) -> Any:
    """`geometry_msgs/Twist`; velocity (6,) in m/s and rad/s."""
    return message("geometry_msgs/msg/Twist", linear=vector(velocity[:3].tolist()), angular=vector(velocity[3:].tolist()))


def point_stamped(t_ns: int, frame: str, xyz: Array) -> Any:
    """`geometry_msgs/PointStamped`."""
    return message("geometry_msgs/msg/PointStamped", header=header(t_ns, frame), point=point(xyz.tolist()))


def joint_state(one: str, position_rad: Array, t_ns: int) -> Any:
    """`sensor_msgs/JointState` of the joints that are seen, without velocities."""
    seen = np.isfinite(position_rad)
    return message(
        "sensor_msgs/msg/JointState",
        header=header(t_ns, ""),
        name=[f"{name}_{one}" for name, known in zip(JOINTS, seen, strict=True) if known],
        position=position_rad[seen],
        velocity=np.zeros(0),
        effort=np.zeros(0),
    )


def _pose(pose: SE3) -> Any:
    orientation = quaternion(pose.wxyz.tolist())
    return message("geometry_msgs/msg/Pose", position=point(pose.xyz.tolist()), orientation=orientation)


def point(xyz: Sequence[float]) -> Any:
    """`geometry_msgs/Point`."""
    x, y, z = xyz
    return message("geometry_msgs/msg/Point", x=x, y=y, z=z)


def vector(xyz: Sequence[float]) -> Any:
    """`geometry_msgs/Vector3`."""
    x, y, z = xyz
    return message("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def quaternion(wxyz: Sequence[float]) -> Any:
    """`geometry_msgs/Quaternion`."""
    w, x, y, z = wxyz
    return message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
