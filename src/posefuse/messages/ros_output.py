"""Everything posefuse shows in ROS: bodies after REP-155, tf, markers, cameras, diagnostics; docs/ros.md lists the topics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from posefuse.core import SE3, Camera, JointAngles, Pose3D, Rig

from . import topics
from .bodies import LINKS, bodies_from_pose
from .body_messages import joint_state, keypoints_seen, region_of_interest, skeleton2d, transform, transforms_of_children
from .camera_messages import info_from_camera
from .markers import camera_markers, person_markers
from .messages import Stages, header, message_from_pose, messages_from_joints, optical_frame
from .person_output import PersonOutput
from .topics import Outlet, Topic
from .types import message
from .velocities import Velocities, angle_difference

CAMERA_MARKERS = Topic("/posefuse/cameras", "visualization_msgs/msg/MarkerArray", depth=1, latched=True)

_FORGOTTEN_AFTER_NS = 3_000_000_000
# topics of a body that need no links
_NOT_OF_LINKS = ("skeleton2d", "roi", "joint_angles", "urdf")


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
        base_frame: frame of the poses of heads and hands, see `PersonOutput`; empty: the world.
    """

    outlet: Outlet
    rig: Rig | None = None
    world_frame: str = "world"
    view_camera: str = ""
    epoch_offset_ns: int = 0
    markers_hz: float = 30.0
    base_frame: str = ""

    def __post_init__(self) -> None:
        self._tracked: tuple[str, ...] | None = None
        # bodies that are not there, whose topics still are: since when
        self._left_ns: dict[str, int] = {}
        self._markers_due_ns: int | None = None
        self._joint_rates = Velocities()
        self.people = PersonOutput(self.outlet, self.world_frame, self.base_frame)
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
        rates = self._joint_rates.step(pose.t_ns, pose.person_id.tolist(), bodies.position_rad, angle_difference)
        for one, position_rad, rate in zip(ids, bodies.position_rad, rates, strict=True):
            topic = topics.body(one, "joint_states")
            if self.outlet.wanted(topic):
                self.outlet.publish(topic, joint_state(one, position_rad, rate, pose.t_ns), pose.t_ns)
        self.people.step(pose, bodies, ids)
        if not frames:
            return
        transforms = self._links(ids, bodies.world_from_link, pose.t_ns)
        if joints is not None:
            roots = {int(p): bodies.world_from_link[n, 0] for n, p in enumerate(pose.person_id)}
            transforms += self._segments(joints, roots, pose.t_ns)
        if transforms:
            self.outlet.publish(topics.TF, message("tf2_msgs/msg/TFMessage", transforms=transforms), pose.t_ns)

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
            self._left_ns |= dict.fromkeys(set(self._tracked or ()) - set(ids), t_ns)
            self._tracked = ids
            self.outlet.publish(topics.TRACKED, message("hri_msgs/msg/IdsList", header=header(t_ns, ""), ids=list(ids)), t_ns)
        # who is lost for a moment keeps the topics: making them anew takes longer than that
        for one, left_ns in list(self._left_ns.items()):
            if one in ids:
                del self._left_ns[one]
            elif not 0 <= t_ns - left_ns < _FORGOTTEN_AFTER_NS:
                del self._left_ns[one]
                self.people.forget(one)
                for part in topics.BODY_PARTS:
                    self.outlet.forget(topics.body(one, part).name)

    def _links(self, ids: Sequence[str], world_from_link: SE3, t_ns: int) -> list[Any]:
        root = LINKS.index("body")
        # a batch of one root per person against all its links
        body_from_world = world_from_link[:, [root] * len(LINKS)].inverse()
        body_from_link = body_from_world @ world_from_link
        found = []
        for n, one in enumerate(ids):
            if np.isfinite(world_from_link.xyz[n, root]).all():
                found.append(transform(t_ns, self.world_frame, f"body_{one}", world_from_link[n, root]))
                found += transforms_of_children(
                    t_ns, f"body_{one}", [f"{name}_{one}" for name in LINKS[1:]], body_from_link[n, 1:]
                )
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
                found += transforms_of_children(t_ns, f"body_{one}", names, still @ joints.world_from_segment[-1, n])
        return found

    def _show_view(self, one: str, pose: Pose3D, n: int, camera: Camera) -> None:
        xy, inside = keypoints_seen(pose, n, camera)
        self.outlet.publish(topics.body(one, "skeleton2d"), skeleton2d(xy, inside, camera, pose.t_ns), pose.t_ns)
        self.outlet.publish(topics.body(one, "roi"), region_of_interest(xy[inside], camera, pose.t_ns), pose.t_ns)


def _at(pose: Pose3D, t_ns: int) -> Pose3D:
    return pose if t_ns == pose.t_ns else replace(pose, t_ns=t_ns)
