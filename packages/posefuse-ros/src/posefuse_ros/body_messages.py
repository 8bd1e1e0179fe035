"""Messages of standard ROS types about bodies: transforms, poses, twists, joint states, boxes. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from posefuse.core import SE3, Camera, Pose3D
from posefuse.core.arrays import Array
from posefuse.core.skeleton import pick_keypoints

from .bodies import JOINTS
from .messages import header, optical_frame
from .types import message

# hri_msgs/Skeleton2D: order of OpenPose's COCO model
_SKELETON2D = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "left_eye", "right_eye",
    "left_ear", "right_ear",
)  # fmt: skip


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


def joint_state(one: str, position_rad: Array, velocity_rad_s: Array, t_ns: int) -> Any:
    """`sensor_msgs/JointState` of the joints that are seen; velocities are 0 where they are not known yet."""
    seen = np.isfinite(position_rad)
    return message(
        "sensor_msgs/msg/JointState",
        header=header(t_ns, ""),
        name=[f"{name}_{one}" for name, known in zip(JOINTS, seen, strict=True) if known],
        position=position_rad[seen],
        velocity=np.nan_to_num(velocity_rad_s[seen]),
        effort=np.zeros(0),
    )


def keypoints_seen(pose: Pose3D, n: int, camera: Camera) -> tuple[Array, Array]:
    """Pixels (18, 2) of person n in the order of `hri_msgs/Skeleton2D`, and which of them are inside the image."""
    xyz = pick_keypoints(pose.xyz_world[n], pose.skeleton, _SKELETON2D)
    xy, size = camera.project(xyz), np.array(camera.size_wh)
    # a lens model bends points far outside the image back into it
    near = np.abs(_straight_px(camera, xyz) - size / 2) < 1.5 * size
    return xy, np.asarray(((xy >= 0) & (xy <= size - 1) & near).all(axis=-1))


def skeleton2d(xy_img: Array, inside: Array, camera: Camera, t_ns: int) -> Any:
    """`hri_msgs/Skeleton2D`, coordinates in 0..1."""
    points = [
        message(
            "hri_msgs/msg/NormalizedPointOfInterest2D",
            x=float(x) if seen else 0.0,
            y=float(y) if seen else 0.0,
            c=float(seen),
        )
        for (x, y), seen in zip(xy_img / _last_px(camera), inside, strict=True)
    ]
    return message("hri_msgs/msg/Skeleton2D", header=header(t_ns, optical_frame(camera.name)), skeleton=points)


def region_of_interest(xy_img: Array, camera: Camera, t_ns: int) -> Any:
    """`hri_msgs/NormalizedRegionOfInterest2D`: smallest box around points (n, 2) inside the image; empty, c = 0, for none."""
    corners = np.concatenate([xy_img.min(axis=0), xy_img.max(axis=0)]) if len(xy_img) else np.zeros(4)
    left, top, right, bottom = (corners / np.tile(_last_px(camera), 2)).tolist()
    return message(
        "hri_msgs/msg/NormalizedRegionOfInterest2D",
        header=header(t_ns, optical_frame(camera.name)),
        xmin=left, ymin=top, xmax=right, ymax=bottom, c=float(len(xy_img) > 0),
    )  # fmt: skip


def _last_px(camera: Camera) -> Array:
    return np.array(camera.size_wh) - 1.0


def _straight_px(camera: Camera, xyz_world: Array) -> Array:
    xyz = camera.cam_from_world @ xyz_world
    return np.asarray((xyz[..., :2] / xyz[..., 2:]) @ camera.K[:2, :2].T + camera.K[:2, 2])


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
