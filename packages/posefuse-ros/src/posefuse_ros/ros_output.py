"""Everything posefuse shows in ROS: bodies after REP-155, tf, markers, cameras, diagnostics; docs/ros.md lists the topics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from posefuse.core import SE3, Camera, JointAngles, Pose3D, Rig
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import ros_name

from . import topics
from .bodies import LINKS, bodies_from_pose
from .body_messages import joint_state, keypoints_seen, region_of_interest, skeleton2d, transform, transforms_of_children
from .camera_messages import info_from_camera
from .markers import camera_markers, person_markers
from .messages import Stages, header, message_from_pose, messages_from_joints, optical_frame
from .parts import Velocities, angle_difference
from .person_output import PersonOutput
from .topics import Outlet, Topic
from .types import message

CAMERA_MARKERS = Topic("/posefuse/cameras", "visualization_msgs/msg/MarkerArray", depth=1, latched=True)

_ROOT = LINKS.index("body")
_FORGOTTEN_AFTER_NS = 3_000_000_000
# topics of a body that need no links
_NOT_OF_LINKS = ("skeleton2d", "roi", "joint_angles", "urdf")


def body_id(person_id: int) -> str:
    """REP-155 id of a person: short, and valid as part of a ROS name."""
    return ros_name(f"p{person_id}")


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
        # bodies that are not there, whose topics still are: since when
        self._left_ns: dict[str, int] = {}
        self._markers_due_ns: int | None = None
        self._joint_rates = Velocities()
        self.people = PersonOutput(self.outlet, self.world_frame)
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
        """Publish what is subscribed to, of one time step. `joints`, if any, are of the same people; the last one is shown."""
        t_ns = pose.t_ns + self.epoch_offset_ns
        moved = {name: stage_ns + self.epoch_offset_ns for name, stage_ns in (stages or {}).items()}
        shifted = _at(pose, t_ns)
        ids = tuple(body_id(int(person)) for person in pose.person_id)
        self._show_tracked(ids, t_ns)
        if self.outlet.wanted(topics.POSE):
            self.outlet.publish(topics.POSE, message_from_pose(shifted, moved, self.world_frame), t_ns)
        self._show_bodies(shifted, joints, ids)
        if joints is not None and any(self.outlet.wanted(topics.body(one, "joint_angles")) for one in ids):
            for msg in messages_from_joints(joints, self.world_frame, t_ns):
                self.outlet.publish(topics.body(body_id(msg.person_id), "joint_angles"), msg, t_ns)
        for n, one in enumerate(ids):
            if self._view is not None and any(self.outlet.wanted(topics.body(one, part)) for part in ("skeleton2d", "roi")):
                self._show_view(one, shifted, n, self._view)
        if self.outlet.wanted(topics.MARKERS) and self._markers_due(t_ns):
            self.outlet.publish(topics.MARKERS, person_markers(shifted, self.world_frame), t_ns)

    def _markers_due(self, t_ns: int) -> bool:
        """Whether it is time for markers again: at due times, which do not move with the poses that happen to come."""
        period_ns, due_ns = round(1e9 / self.markers_hz), self._markers_due_ns
        if due_ns is None or not -period_ns <= t_ns - due_ns < period_ns:
            due_ns = t_ns
        # a pose that comes a little early counts: due times are no more exact than the clock that poses come by
        if t_ns < due_ns - period_ns // 20:
            return False
        self._markers_due_ns = due_ns + period_ns
        return True

    def _show_bodies(self, pose: Pose3D, joints: JointAngles | None, ids: Sequence[str]) -> None:
        """Frames of links and segments, the joints of the REP-155 model, and what robots follow."""
        self.people.show_models(pose, ids)
        parts = [part for part in topics.BODY_PARTS if part not in _NOT_OF_LINKS]
        frames = self.outlet.wanted(topics.TF)
        if not (frames or any(self.outlet.wanted(topics.body(one, part)) for one in ids for part in parts)):
            return
        bodies = bodies_from_pose(pose)
        if any(self.outlet.wanted(topics.body(one, "joint_states")) for one in ids):
            self._show_joints(pose, bodies.position_rad, ids)
        self.people.step(pose, bodies, ids)
        if not frames:
            return
        transforms = self._frames(pose, joints, ids, bodies.world_from_link)
        if transforms:
            self.outlet.publish(topics.TF, message("tf2_msgs/msg/TFMessage", transforms=transforms), pose.t_ns)

    def _show_joints(self, pose: Pose3D, positions_rad: Array, ids: Sequence[str]) -> None:
        rates = self._joint_rates.step(pose.t_ns, pose.person_id.tolist(), positions_rad, angle_difference)
        for one, position_rad, rate in zip(ids, positions_rad, rates, strict=True):
            topic = topics.body(one, "joint_states")
            if self.outlet.wanted(topic):
                self.outlet.publish(topic, joint_state(one, position_rad, rate, pose.t_ns), pose.t_ns)

    def diagnose(self, t_ns: int, status: Sequence[Any]) -> None:
        """Publish the state of cameras and stages, each a `messages.diagnostic_status`."""
        t_ns += self.epoch_offset_ns
        msg = message("diagnostic_msgs/msg/DiagnosticArray", header=header(t_ns, ""), status=list(status))
        self.outlet.publish(topics.DIAGNOSTICS, msg, t_ns)

    def _show_tracked(self, ids: tuple[str, ...], t_ns: int) -> None:
        if ids != self._tracked:
            self._left_ns |= dict.fromkeys(set(self._tracked or ()) - set(ids), t_ns)
            self._tracked = ids
            self.outlet.publish(topics.TRACKED, message("hri_msgs/msg/IdsList", header=header(t_ns, ""), ids=list(ids)), t_ns)
        # who is lost for a moment keeps the topics: making them again takes longer than that
        for one, left_ns in list(self._left_ns.items()):
            if one in ids:
                del self._left_ns[one]
            elif not 0 <= t_ns - left_ns < _FORGOTTEN_AFTER_NS:
                del self._left_ns[one]
                self.people.forget(one)
                for part in topics.BODY_PARTS:
                    self.outlet.forget(topics.body(one, part).name)

    def _frames(self, pose: Pose3D, joints: JointAngles | None, ids: Sequence[str], world_from_link: SE3) -> list[Any]:
        """Transforms of everybody's links, then of everybody's segments; all are children of the body."""
        places = {} if joints is None else {person: n for n, person in enumerate(joints.person_id.tolist())}
        links, segments = [], []
        for n, (one, person) in enumerate(zip(ids, pose.person_id.tolist(), strict=True)):
            root = world_from_link[n, _ROOT]
            if not np.isfinite(root.xyz).all():
                continue
            body, own, wxyz, xyz = f"body_{one}", places.get(person), [world_from_link.wxyz[n, 1:]], [world_from_link.xyz[n, 1:]]
            link_names, segment_names = _frame_names(one, () if joints is None or own is None else joints.segments)
            if joints is not None and own is not None:
                wxyz.append(joints.world_from_segment.wxyz[-1, own])
                xyz.append(joints.world_from_segment.xyz[-1, own])
            world_from_child = SE3(np.concatenate(wxyz), np.concatenate(xyz))
            back = root.inverse()
            # a batch of one body against all its children
            body_from_world = SE3(*(np.broadcast_to(a, (*world_from_child.batch, a.size)) for a in (back.wxyz, back.xyz)))
            body_from_child, count = body_from_world @ world_from_child, len(link_names)
            links.append(transform(pose.t_ns, self.world_frame, body, root))
            links += transforms_of_children(pose.t_ns, body, link_names, body_from_child[:count])
            segments += transforms_of_children(pose.t_ns, body, segment_names, body_from_child[count:])
        return links + segments

    def _show_view(self, one: str, pose: Pose3D, n: int, camera: Camera) -> None:
        xy, inside = keypoints_seen(pose, n, camera)
        skeleton, box = topics.body(one, "skeleton2d"), topics.body(one, "roi")
        if self.outlet.wanted(skeleton):
            self.outlet.publish(skeleton, skeleton2d(xy, inside, camera, pose.t_ns), pose.t_ns)
        if self.outlet.wanted(box):
            self.outlet.publish(box, region_of_interest(xy[inside], camera, pose.t_ns), pose.t_ns)


@lru_cache(maxsize=256)
def _frame_names(one: str, segments: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """tf names of the links of a body, the root excepted, and of its segments."""
    links = tuple(f"{name}_{one}" for name in LINKS if name != LINKS[_ROOT])
    return links, tuple(f"segment_{ros_name(name)}_{one}" for name in segments)


def _at(pose: Pose3D, t_ns: int) -> Pose3D:
    return pose if t_ns == pose.t_ns else replace(pose, t_ns=t_ns)
