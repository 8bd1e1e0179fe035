"""Everything posefuse shows in ROS: bodies after REP-155, tf, markers, cameras, diagnostics.

| topic | type | when |
|---|---|---|
| /humans/bodies/tracked | hri_msgs/IdsList | who is there changes (latched) |
| /humans/bodies/<id>/joint_states | sensor_msgs/JointState | each step; joints of the REP-155 human model |
| /humans/bodies/<id>/skeleton2d, roi | hri_msgs/Skeleton2D, sensor_msgs/RegionOfInterest | each step; as one camera sees it |
| /humans/bodies/<id>/joint_angles | posefuse_msgs/JointAngles | each step with joints; anatomical angles with sigma |
| /posefuse/pose | posefuse_msgs/Pose3D | each step; keypoints, covariances, stage times |
| /posefuse/markers | visualization_msgs/MarkerArray | at most 30 times a second; for RViz |
| /tf | tf2_msgs/TFMessage | each step; links <name>_<id>, anatomical segments segment_<name>_<id> |
| /tf_static, /posefuse/<camera>/camera_info, /posefuse/cameras | TFMessage, CameraInfo, MarkerArray | once (latched) |
| /diagnostics | diagnostic_msgs/DiagnosticArray | when told |
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from posefuse.core import SE3, Camera, JointAngles, Pose3D, Rig
from posefuse.core.arrays import Array
from posefuse.core.skeleton import pick_keypoints

from . import topics
from .bodies import JOINTS, LINKS, bodies_from_pose
from .camera_messages import info_from_camera
from .markers import camera_markers, person_markers
from .messages import Stages, header, message_from_pose, messages_from_joints, optical_frame
from .topics import Outlet, Topic
from .types import message

CAMERA_MARKERS = Topic("/posefuse/cameras", "visualization_msgs/msg/MarkerArray", depth=1, latched=True)
# hri_msgs/Skeleton2D: order of OpenPose's COCO model
_SKELETON2D = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "left_eye", "right_eye",
    "left_ear", "right_ear",
)  # fmt: skip


@dataclass(frozen=True)
class Health:
    """One line of diagnostics.

    Attributes:
        name: e.g. ``camera cam02``. level: 0 ok, 1 warning, 2 error, 3 stale. text: what is the matter.
        values: figures to show, already with their units.
    """

    name: str
    level: int
    text: str
    values: Mapping[str, str] = field(default_factory=dict)


def body_id(person_id: int) -> str:
    """REP-155 id of a person: short, and valid as part of a ROS name."""
    return topics.ros_name(f"p{person_id}")


@dataclass
class RosOutput:
    """Publishes poses to an outlet (ROS 2 node, ROS 1 node, recording).

    Attributes:
        outlet: where to.
        rig: cameras to show; None when unknown.
        world_frame: tf name of the world.
        view_camera: whose view `skeleton2d` and `roi` give; empty takes the rig's first.
        epoch_offset_ns: Unix epoch minus session clock, added to every stamp.
        markers_hz: most markers per second; eyes need fewer than robots need poses.
    """

    outlet: Outlet
    rig: Rig | None = None
    world_frame: str = "world"
    view_camera: str = ""
    epoch_offset_ns: int = 0
    markers_hz: float = 30.0

    def __post_init__(self) -> None:
        self._tracked: tuple[str, ...] | None = None
        self._marked_ns: int | None = None
        self._view: Camera | None = None
        if self.rig is not None:
            self._view = self.rig[self.view_camera] if self.view_camera else self.rig.cameras[0]

    def start(self, t_ns: int) -> None:
        """Publish what does not change: where the cameras are and how they see."""
        if self.rig is None:
            return
        t_ns += self.epoch_offset_ns
        poses = [transform(t_ns, self.world_frame, optical_frame(c.name), c.cam_from_world.inverse()) for c in self.rig]
        self.outlet.publish(topics.TF_STATIC, message("tf2_msgs/msg/TFMessage", transforms=poses), t_ns)
        for camera in self.rig:
            self.outlet.publish(topics.camera_info(camera.name), info_from_camera(camera, t_ns), t_ns)
        self.outlet.publish(CAMERA_MARKERS, camera_markers(self.rig, t_ns, self.world_frame), t_ns)

    def step(self, pose: Pose3D, joints: JointAngles | None = None, stages: Stages | None = None) -> None:
        """Publish what somebody wants of one instant. `joints`, if any, are of the same people; their last instant is shown."""
        t_ns = pose.t_ns + self.epoch_offset_ns
        moved = {name: stage_ns + self.epoch_offset_ns for name, stage_ns in (stages or {}).items()}
        shifted = _at(pose, t_ns)
        ids = tuple(body_id(int(person)) for person in pose.person_id)
        self._show_tracked(ids, t_ns)
        if self.outlet.wanted(topics.POSE):
            self.outlet.publish(topics.POSE, message_from_pose(shifted, moved, self.world_frame), t_ns)
        self._show_bodies(pose, joints, ids, t_ns)
        if joints is not None and any(self.outlet.wanted(topics.body(one, "joint_angles")) for one in ids):
            for msg in messages_from_joints(joints, self.world_frame, t_ns):
                self.outlet.publish(topics.body(body_id(msg.person_id), "joint_angles"), msg, t_ns)
        for n, one in enumerate(ids):
            if self._view is not None and any(self.outlet.wanted(topics.body(one, part)) for part in ("skeleton2d", "roi")):
                self._show_view(one, shifted, n, self._view)
        due = self._marked_ns is None or not 0 <= t_ns - self._marked_ns < 1e9 / self.markers_hz
        if self.outlet.wanted(topics.MARKERS) and due:
            self._marked_ns = t_ns
            self.outlet.publish(topics.MARKERS, person_markers(shifted, self.world_frame), t_ns)

    def _show_bodies(self, pose: Pose3D, joints: JointAngles | None, ids: Sequence[str], t_ns: int) -> None:
        """Frames of links and segments, and the joints of the REP-155 model."""
        states = [topics.body(one, "joint_states") for one in ids]
        wanted = [self.outlet.wanted(topic) for topic in states]
        frames = self.outlet.wanted(topics.TF)
        if not (frames or any(wanted)):
            return
        bodies = bodies_from_pose(pose)
        for one, topic, asked, position_rad in zip(ids, states, wanted, bodies.position_rad, strict=True):
            if asked:
                self.outlet.publish(topic, _joint_state(one, position_rad, t_ns), t_ns)
        transforms = self._links(ids, bodies.world_from_link, t_ns) if frames else []
        if frames and joints is not None:
            roots = {int(p): bodies.world_from_link[n, 0] for n, p in enumerate(pose.person_id)}
            transforms += self._segments(joints, roots, t_ns)
        if transforms:
            self.outlet.publish(topics.TF, message("tf2_msgs/msg/TFMessage", transforms=transforms), t_ns)

    def diagnose(self, t_ns: int, health: Sequence[Health]) -> None:
        """Publish the state of cameras and stages."""
        t_ns += self.epoch_offset_ns
        status = [
            message(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level=h.level,
                name=f"posefuse: {h.name}",
                message=h.text,
                hardware_id=h.name,
                values=[message("diagnostic_msgs/msg/KeyValue", key=k, value=v) for k, v in h.values.items()],
            )
            for h in health
        ]
        msg = message("diagnostic_msgs/msg/DiagnosticArray", header=header(t_ns, ""), status=status)
        self.outlet.publish(topics.DIAGNOSTICS, msg, t_ns)

    def _show_tracked(self, ids: tuple[str, ...], t_ns: int) -> None:
        if ids != self._tracked:
            for gone in set(self._tracked or ()) - set(ids):
                for part in topics.BODY_PARTS:
                    self.outlet.forget(topics.body(gone, part).name)
            self._tracked = ids
            self.outlet.publish(topics.TRACKED, message("hri_msgs/msg/IdsList", header=header(t_ns, ""), ids=list(ids)), t_ns)

    def _links(self, ids: Sequence[str], world_from_link: SE3, t_ns: int) -> list[Any]:
        root = LINKS.index("body")
        # a batch of one root per person against all its links
        body_from_world = world_from_link[:, [root] * len(LINKS)].inverse()
        body_from_link = body_from_world @ world_from_link
        found = []
        for n, one in enumerate(ids):
            if np.isfinite(world_from_link.xyz[n, root]).all():
                found.append(transform(t_ns, self.world_frame, f"body_{one}", world_from_link[n, root]))
                found += _children(t_ns, f"body_{one}", [f"{name}_{one}" for name in LINKS[1:]], body_from_link[n, 1:])
        return found

    def _segments(self, joints: JointAngles, roots: Mapping[int, SE3], t_ns: int) -> list[Any]:
        found = []
        for n, person in enumerate(map(int, joints.person_id)):
            root = roots.get(person)
            if root is not None and np.isfinite(root.xyz).all():
                one = body_id(person)
                names = [f"segment_{topics.ros_name(name)}_{one}" for name in joints.segments]
                body_from_world = root.inverse()
                still = SE3(*(np.broadcast_to(a, (len(names), a.size)) for a in (body_from_world.wxyz, body_from_world.xyz)))
                found += _children(t_ns, f"body_{one}", names, still @ joints.world_from_segment[-1, n])
        return found

    def _show_view(self, one: str, pose: Pose3D, n: int, camera: Camera) -> None:
        xyz = pick_keypoints(pose.xyz_world[n], pose.skeleton, _SKELETON2D)
        xy = camera.project(xyz)
        size = np.array(camera.size_wh)
        # a lens model bends points far outside the image back into it
        near = np.abs(_straight_px(camera, xyz) - size / 2) < 1.5 * size
        inside = np.asarray(((xy >= 0) & (xy <= size - 1) & near).all(axis=-1))
        self.outlet.publish(topics.body(one, "skeleton2d"), _skeleton2d(xy / (size - 1), inside, camera, pose.t_ns), pose.t_ns)
        self.outlet.publish(topics.body(one, "roi"), _roi(xy[inside], camera), pose.t_ns)


def publish_pose(outlet: Outlet, pose: Pose3D, joints: JointAngles | None, stages: Stages) -> None:
    """The topics a replay needs and nothing else: the pose, and everybody's joint angles."""
    outlet.publish(topics.POSE, message_from_pose(pose, stages, "world"), pose.t_ns)
    for msg in messages_from_joints(joints, "world", pose.t_ns) if joints is not None else ():
        outlet.publish(topics.body(body_id(msg.person_id), "joint_angles"), msg, pose.t_ns)


def transform(t_ns: int, parent: str, child: str, parent_from_child: SE3) -> Any:
    """`geometry_msgs/TransformStamped`: where `child` is in `parent`."""
    return _transform(t_ns, parent, child, parent_from_child.wxyz.tolist(), parent_from_child.xyz.tolist())


def _transform(t_ns: int, parent: str, child: str, wxyz: list[float], xyz: list[float]) -> Any:
    w, x, y, z = wxyz
    return message(
        "geometry_msgs/msg/TransformStamped",
        header=header(t_ns, parent),
        child_frame_id=child,
        transform=message(
            "geometry_msgs/msg/Transform",
            translation=message("geometry_msgs/msg/Vector3", x=xyz[0], y=xyz[1], z=xyz[2]),
            rotation=message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        ),
    )


def _children(t_ns: int, parent: str, names: Sequence[str], parent_from_child: SE3) -> list[Any]:
    """One transform per name that is not NaN; `parent_from_child` has one batch axis."""
    seen = np.asarray(np.isfinite(parent_from_child.wxyz).all(axis=-1) & np.isfinite(parent_from_child.xyz).all(axis=-1))
    poses = zip(names, parent_from_child.wxyz.tolist(), parent_from_child.xyz.tolist(), seen, strict=True)
    return [_transform(t_ns, parent, name, wxyz, xyz) for name, wxyz, xyz, known in poses if known]


def _at(pose: Pose3D, t_ns: int) -> Pose3D:
    from dataclasses import replace

    return pose if t_ns == pose.t_ns else replace(pose, t_ns=t_ns)


def _joint_state(one: str, position_rad: Array, t_ns: int) -> Any:
    nothing = np.zeros(0)
    seen = np.isfinite(position_rad)
    return message(
        "sensor_msgs/msg/JointState",
        header=header(t_ns, ""),
        name=[f"{name}_{one}" for name, known in zip(JOINTS, seen, strict=True) if known],
        position=position_rad[seen],
        velocity=nothing,
        effort=nothing,
    )


def _straight_px(camera: Camera, xyz_world: Array) -> Array:
    xyz = camera.cam_from_world @ xyz_world
    return np.asarray((xyz[..., :2] / xyz[..., 2:]) @ camera.K[:2, :2].T + camera.K[:2, 2])


def _skeleton2d(xy_unit: Array, inside: Array, camera: Camera, t_ns: int) -> Any:
    points = [
        message(
            "hri_msgs/msg/NormalizedPointOfInterest2D",
            x=float(x) if seen else 0.0,
            y=float(y) if seen else 0.0,
            c=float(seen),
        )
        for (x, y), seen in zip(xy_unit, inside, strict=True)
    ]
    return message("hri_msgs/msg/Skeleton2D", header=header(t_ns, optical_frame(camera.name)), skeleton=points)


def _roi(xy_img: Array, camera: Camera) -> Any:
    """Smallest box around what is inside the image; empty when nothing is."""
    left, top, right, bottom = 0, 0, 0, 0
    if len(xy_img):
        left, top = (int(v) for v in np.floor(xy_img.min(axis=0)))
        right, bottom = (int(v) + 1 for v in np.ceil(xy_img.max(axis=0)))
    return message(
        "sensor_msgs/msg/RegionOfInterest",
        x_offset=left,
        y_offset=top,
        height=min(bottom, camera.size_wh[1]) - top,
        width=min(right, camera.size_wh[0]) - left,
        do_rectify=False,
    )
