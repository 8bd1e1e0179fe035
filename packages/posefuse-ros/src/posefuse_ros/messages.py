"""2D and 3D poses, and names of people, as messages and back. Pure functions; layouts are in `msg/posefuse_msgs`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from posefuse.core import SKELETONS, Detections2D, JointAngles, Kind, MessageError, Pose3D, PosefuseError, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.joint_angles import angle_labels
from posefuse.health.cameras import CameraState

from .types import message

Stages = Mapping[str, int]
DETECTIONS_TYPE = "posefuse_msgs/msg/Detections2D"
POSE_TYPE = "posefuse_msgs/msg/Pose3D"
JOINT_ANGLES_TYPE = "posefuse_msgs/msg/JointAngles"
MAX_PEOPLE = 64
MAX_KEYPOINTS = 512
# 1000 frames a second for a year
MAX_FRAMES = 2**35
_NS = 1_000_000_000
_MIN_NS, _MAX_NS = -(2**31) * _NS, 2**31 * _NS - 1
_UPPER = np.triu_indices(3)
NAMES_TYPE = "std_msgs/msg/String"


def time_from_ns(t_ns: int) -> Any:
    """A `builtin_interfaces/Time`; raises MessageError outside the years it can hold (1901 to 2038)."""
    if not _MIN_NS <= t_ns <= _MAX_NS:
        raise MessageError(f"time: a ROS stamp holds {_MIN_NS} to {_MAX_NS} ns, got {t_ns}")
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
        xy_px=detections.xy_img.ravel(),
        score=detections.score.ravel(),
        sigma_px=detections.sigma_px.ravel(),
        box_px=detections.box_img.ravel(),
        clothing_lab=_known_or_empty(detections.clothing_lab),
        depth_m=np.zeros(0, np.float32) if detections.depth_m is None else detections.depth_m.ravel(),
        stages=_stage_list(stages),
        captured=state.captured if state else 0,
        used=state.used if state else 0,
    )


def state_from_message(msg: Any) -> CameraState | None:
    """The counts of the camera in a `Detections2D` message, None where it has none; raises MessageError for impossible ones."""
    # a recording of an older version has none
    captured, used = (int(getattr(msg, name, 0)) for name in ("captured", "used"))
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
    xy = _shaped(msg.xy_px, (people, k, 2), where, "xy_px")
    score = _shaped(msg.score, (people, k), where, "score")
    sigma = _shaped(msg.sigma_px, (people, k), where, "sigma_px")
    box = _shaped(msg.box_px, (people, 4), where, "box_px")
    # a recording of an older version has none
    worn = getattr(msg, "clothing_lab", ())
    clothing = _shaped(worn, (people, 3, 3), where, "clothing_lab") if len(worn) else np.zeros((0, 3, 3))
    # no camera of an older version has depth
    sent = getattr(msg, "depth_m", ())
    depth = _shaped(sent, (people, k, 2), where, "depth_m") if len(sent) else None
    if depth is not None and (np.isinf(depth).any() or (depth < 0).any()):
        raise MessageError(f"{where} of {msg.camera}: expected depths and their sigmas >= 0, finite or NaN")
    if np.isinf(clothing).any():
        raise MessageError(f"{where} of {msg.camera}: expected finite colours or NaN")
    if not ((score >= 0) & (score <= 1)).all() or np.isinf(xy).any() or (sigma < 0).any() or np.isinf(sigma).any():
        raise MessageError(f"{where} of {msg.camera}: expected scores in 0..1, finite or NaN px and sigma >= 0")
    if (np.isnan(xy).any(axis=-1) & (score > 0)).any():
        raise MessageError(f"{where} of {msg.camera}: expected score 0 where a keypoint is NaN")
    return Detections2D(
        camera=msg.camera,
        t_ns=ns_from_time(msg.header.stamp),
        skeleton=skeleton,
        xy_img=xy,
        score=score,
        sigma_px=sigma,
        box_img=box,
        clothing_lab=clothing,
        depth_m=depth,
    ), _stages(msg)


def _known_or_empty(array: Array) -> Array:
    return array.ravel() if np.isfinite(array).any() else np.zeros(0, array.dtype)


def message_from_pose(pose: Pose3D, stages: Stages, world_frame: str) -> Any:
    """`posefuse_msgs/Pose3D` of one time step."""
    return message(
        POSE_TYPE,
        header=header(pose.t_ns, world_frame),
        skeleton=pose.skeleton.name,
        keypoints=list(pose.skeleton.keypoints),
        person_id=pose.person_id,
        xyz_m=pose.xyz_world.ravel(),
        covariance_m2=pose.cov_world[..., _UPPER[0], _UPPER[1]].ravel(),
        reprojection_px=pose.reproj_px.ravel(),
        views=pose.n_views.ravel(),
        kind=pose.kind.ravel(),
        stages=_stage_list(stages),
    )


def pose_from_message(msg: Any) -> tuple[Pose3D, dict[str, int]]:
    """The people and their stages; raises MessageError for anything that does not fit."""
    where = "Pose3D message"
    skeleton = _skeleton(msg, where)
    n, k = len(msg.person_id), len(skeleton)
    if n > MAX_PEOPLE:
        raise MessageError(f"{where}: expected at most {MAX_PEOPLE} people, got {n}")
    xyz = _shaped(msg.xyz_m, (n, k, 3), where, "xyz_m")
    upper = _shaped(msg.covariance_m2, (n, k, 6), where, "covariance_m2")
    kind = _shaped(msg.kind, (n, k), where, "kind")
    if np.isinf(xyz).any() or np.isinf(upper).any():
        raise MessageError(f"{where}: expected finite values or NaN, got infinity")
    if kind.size and kind.max() > max(Kind):
        raise MessageError(f"{where}: kind: expected 0 to {max(Kind)}, got {kind.max()}")
    cov = np.empty((n, k, 3, 3))
    cov[..., _UPPER[0], _UPPER[1]] = upper
    cov[..., _UPPER[1], _UPPER[0]] = upper
    pose = Pose3D(
        t_ns=ns_from_time(msg.header.stamp),
        skeleton=skeleton,
        person_id=np.asarray(msg.person_id),
        xyz_world=xyz,
        cov_world=cov,
        reproj_px=_shaped(msg.reprojection_px, (n, k), where, "reprojection_px"),
        n_views=_shaped(msg.views, (n, k), where, "views"),
        kind=kind,
    )
    return pose, _stages(msg)


def messages_from_joints(joints: JointAngles, world_frame: str, t_ns: int) -> list[Any]:
    """`posefuse_msgs/JointAngles` of each person at the last time step of `joints`, stamped `t_ns`."""
    names = angle_labels(joints, "/")
    return [
        message(
            JOINT_ANGLES_TYPE,
            header=header(t_ns, world_frame),
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


def _shaped(values: Any, shape: Sequence[int], where: str, field: str) -> Array:
    array = np.asarray(values)
    if array.size != int(np.prod(shape)):
        axes = " x ".join(map(str, shape))
        raise MessageError(f"{where}: {field} holds {array.size} numbers, expected {axes}")
    return array.reshape(shape)


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
