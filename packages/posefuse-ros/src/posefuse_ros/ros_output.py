"""Everything posefuse shows in ROS: bodies after REP-155, tf, markers, cameras, diagnostics.

And what robots follow of each person: poses of head, wrists and hands.
docs/reference/messages.md lists the topics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from posefuse.core import SE3, JointAngles, Pose3D, Rig
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import ros_name

from . import topics
from .bodies import (
    LINKS,
    PARTS,
    Bodies,
    bodies_from_pose,
    covariance_of_parts,
    parts_from_pose,
)
from .camera_messages import info_from_camera
from .markers import camera_markers, person_markers
from .messages import (
    WORLD,
    Stages,
    header,
    joint_state,
    message_from_pose,
    messages_from_joints,
    optical_frame,
    pose_stamped,
    pose_with_covariance,
    transform,
    transforms_of_children,
)
from .topics import Outlet, Topic
from .types import message

CAMERA_MARKERS = Topic("/posefuse/cameras", "visualization_msgs/msg/MarkerArray", depth=1, latched=True)

_BODY = LINKS.index("body")
_FORGOTTEN_AFTER_NS = 3_000_000_000
# topics of a body that are made of its links
_OF_LINKS = [part for part in topics.BODY_PARTS if part != "joint_angles"]
# so often at most what viewers draw is made: eyes need less than robots
SHOWN_NS = 1_000_000_000 // 30


def body_id(person_id: int) -> str:
    """REP-155 id of a person: short, and valid as part of a ROS name."""
    return ros_name(f"p{person_id}")


class ShownTimes:
    """When to make what viewers draw: at due times, which do not move with the poses that happen to come."""

    def __init__(self) -> None:
        self._due_ns: int | None = None

    def due(self, t_ns: int) -> bool:
        """Whether it is time again at `t_ns`; then it is not before a period has passed."""
        due_ns = self._due_ns
        if due_ns is None or not -SHOWN_NS <= t_ns - due_ns < SHOWN_NS:
            due_ns = t_ns
        # a pose that comes a little early counts: due times are no more exact than the clock that poses come by
        if t_ns < due_ns - SHOWN_NS // 20:
            return False
        self._due_ns = due_ns + SHOWN_NS
        return True


class RosOutput:
    """Publishes poses to an outlet (ROS 2 node, ROS 1 node, recording), only what is wanted.

    Attributes:
        outlet: where to.
        rig: cameras to show; None when unknown.
        epoch_offset_ns: Unix epoch minus session clock, added to every stamp.
    """

    def __init__(self, outlet: Outlet, rig: Rig | None = None, epoch_offset_ns: int = 0) -> None:
        self.outlet, self.rig, self.epoch_offset_ns = outlet, rig, epoch_offset_ns
        self._tracked: tuple[str, ...] | None = None
        # bodies that are not there, whose topics still are: since when
        self._left_ns: dict[str, int] = {}
        self._markers = ShownTimes()

    def start(self, t_ns: int) -> None:
        """Publish what does not change: where the cameras are and how they see."""
        if self.rig is None:
            return
        t_ns += self.epoch_offset_ns
        poses = [transform(t_ns, WORLD, optical_frame(c.name), c.cam_from_world.inverse()) for c in self.rig]
        self.outlet.publish(topics.TF_STATIC, message("tf2_msgs/msg/TFMessage", transforms=poses), t_ns)
        for camera in self.rig:
            self.outlet.publish(topics.camera_info(camera.name), info_from_camera(camera, t_ns), t_ns)
        self.outlet.publish(CAMERA_MARKERS, camera_markers(self.rig, t_ns), t_ns)

    def step(self, pose: Pose3D, joints: JointAngles | None = None, stages: Stages | None = None) -> None:
        """Publish what is subscribed to, of one time step. `joints`, if any, are of the same people; the last one is shown."""
        t_ns = pose.t_ns + self.epoch_offset_ns
        moved = {name: stage_ns + self.epoch_offset_ns for name, stage_ns in (stages or {}).items()}
        shifted = pose if t_ns == pose.t_ns else replace(pose, t_ns=t_ns)
        ids = tuple(body_id(int(person)) for person in pose.person_id)
        self._show_tracked(ids, t_ns)
        if self.outlet.wanted(topics.POSE):
            self.outlet.publish(topics.POSE, message_from_pose(shifted, moved), t_ns)
        self._show_bodies(shifted, joints, ids)
        if joints is not None and self._wanted(ids, "joint_angles"):
            for msg in messages_from_joints(joints, t_ns):
                self.outlet.publish(topics.body(body_id(msg.person_id), "joint_angles"), msg, t_ns)
        if self.outlet.wanted(topics.MARKERS) and self._markers.due(t_ns):
            self.outlet.publish(topics.MARKERS, person_markers(shifted), t_ns)

    def _wanted(self, ids: Sequence[str], *parts: str) -> bool:
        """Whether any of these topics of any of these bodies is wanted."""
        return any(self.outlet.wanted(topics.body(one, part)) for one in ids for part in parts)

    def _show_bodies(self, pose: Pose3D, joints: JointAngles | None, ids: Sequence[str]) -> None:
        """Frames of links and segments, the joints of the REP-155 model, and what robots follow."""
        frames = self.outlet.wanted(topics.TF)
        if not (frames or self._wanted(ids, *_OF_LINKS)):
            return
        bodies = bodies_from_pose(pose)
        if self._wanted(ids, "joint_states"):
            self._show_joints(pose, bodies.position_rad, ids)
        if self._wanted(ids, *topics.OF_PARTS):
            self._show_parts(pose, bodies, ids)
        if not frames:
            return
        transforms = self._frames(pose, joints, ids, bodies.world_from_link)
        if transforms:
            self.outlet.publish(topics.TF, message("tf2_msgs/msg/TFMessage", transforms=transforms), pose.t_ns)

    def _show_joints(self, pose: Pose3D, positions_rad: Array, ids: Sequence[str]) -> None:
        for one, position_rad in zip(ids, positions_rad, strict=True):
            topic = topics.body(one, "joint_states")
            if self.outlet.wanted(topic):
                self.outlet.publish(topic, joint_state(one, position_rad, pose.t_ns), pose.t_ns)

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
                for part in topics.BODY_PARTS:
                    self.outlet.forget(topics.body(one, part).name)

    def _frames(self, pose: Pose3D, joints: JointAngles | None, ids: Sequence[str], world_from_link: SE3) -> list[Any]:
        """Transforms of everybody's links, then of everybody's segments; all are children of the body."""
        places = {} if joints is None else {person: n for n, person in enumerate(joints.person_id.tolist())}
        links, segments = [], []
        for n, (one, person) in enumerate(zip(ids, pose.person_id.tolist(), strict=True)):
            root = world_from_link[n, _BODY]
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
            links.append(transform(pose.t_ns, WORLD, body, root))
            links += transforms_of_children(pose.t_ns, body, link_names, body_from_child[:count])
            segments += transforms_of_children(pose.t_ns, body, segment_names, body_from_child[count:])
        return links + segments

    def _show_parts(self, pose: Pose3D, bodies: Bodies, ids: Sequence[str]) -> None:
        parts = parts_from_pose(pose, bodies)
        cov = np.full((*parts.batch, 6, 6), np.nan)
        if self._wanted(ids, *(f"{part}/pose_with_covariance" for part in PARTS)):
            cov = covariance_of_parts(pose, parts)
        t_ns = pose.t_ns
        sure = np.isfinite(cov).all(axis=(-1, -2))
        for n, p in np.argwhere(np.isfinite(parts.xyz).all(axis=-1)).tolist():
            in_pose, in_cov = (topics.body(ids[n], f"{PARTS[p]}/{what}") for what in topics.PART_TOPICS)
            here = parts[n, p]
            if self.outlet.wanted(in_pose):
                self.outlet.publish(in_pose, pose_stamped(t_ns, WORLD, here), t_ns)
            if sure[n, p] and self.outlet.wanted(in_cov):
                self.outlet.publish(in_cov, pose_with_covariance(t_ns, WORLD, here, cov[n, p]), t_ns)


@lru_cache(maxsize=256)
def _frame_names(one: str, segments: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """tf names of the links of a body, the root excepted, and of its segments."""
    links = tuple(f"{name}_{one}" for name in LINKS if name != LINKS[_BODY])
    return links, tuple(f"segment_{ros_name(name)}_{one}" for name in segments)
