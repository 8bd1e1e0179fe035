"""Live outputs ``ros2`` and ``ros1``: topics of docs/ros.md, with or without an installed ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Le

from posefuse.core import (
    LiveDetections,
    LiveExpected,
    LiveHealth,
    LiveJointCentres,
    LiveMessage,
    LiveOutput,
    LivePose,
    LivePreview,
    LiveStart,
    OutputHealth,
    Rig,
)
from posefuse.foundation.settings import settings
from posefuse.messages import topics
from posefuse.messages.camera_messages import info_from_camera, message_from_joint_centres
from posefuse.messages.messages import header, message_from_detections, message_from_pose, optical_frame
from posefuse.messages.ros_output import Health, RosOutput
from posefuse.messages.types import message

_OK, _WARNING, _ERROR = 0, 1, 2
_LEVELS = dict.fromkeys(("opening", "flood", "clock", "late", "overload", "moved", "unsynchronised", "hangs"), _WARNING) | {
    "ok": _OK
}
# how long a simulator may take to publish its time
_CLOCK_WITHIN_S = 10.0
_EVERYTHING = (LiveDetections, LivePose, LiveExpected, LiveJointCentres, LiveHealth, LivePreview)


@settings
class Ros2Config:
    """ROS 2 topics over DDS; no ROS needed.

    Attributes:
        domain_id: ROS_DOMAIN_ID. local_only: nothing leaves this machine. interface: network card; empty: the library chooses.
        peers: other machines, where multicast is off. detections: publish 2D poses too; not where they came from ROS.
        sim_time: stamps are simulated time, from `/clock` (ROS: `use_sim_time`).
        middleware: ``auto`` takes rclpy where a ROS 2 environment is sourced and no network option is given, else DDS.
    """

    domain_id: Annotated[int, Ge(0), Le(232)] = 0
    local_only: bool = False
    interface: str = ""
    peers: tuple[str, ...] = ()
    detections: bool = True
    sim_time: bool = False
    middleware: Literal["auto", "dds", "rclpy"] = "auto"
    takes: ClassVar[tuple[type[LiveMessage], ...]] = _EVERYTHING
    keeps_all: ClassVar[bool] = False

    def build(self) -> LiveOutput:
        """Not yet opened; raises DependencyError without the extra `ros`."""
        from posefuse.messages.dds_domain import require_tested_cyclonedds

        if not self._by_rclpy():
            require_tested_cyclonedds()
        return RosLiveOutput("ros2", self._node, f"ROS 2 domain {self.domain_id}", self)

    def _by_rclpy(self) -> bool:
        from posefuse.messages.rclpy_node import ros2_is_sourced

        plain = not (self.local_only or self.interface or self.peers)
        return self.middleware == "rclpy" or (self.middleware == "auto" and plain and ros2_is_sourced())

    def _node(self) -> Any:
        from posefuse.messages.dds import RosNode
        from posefuse.messages.dds_domain import Network
        from posefuse.messages.rclpy_node import RclpyNode

        if self._by_rclpy():
            return RclpyNode("posefuse", self.domain_id)
        return RosNode(
            "posefuse", Network(domain_id=self.domain_id, local_only=self.local_only, interface=self.interface, peers=self.peers)
        )


@settings
class Ros1Config:
    """ROS 1 topics at the master that ROS_MASTER_URI names; needs rospy."""

    takes: ClassVar[tuple[type[LiveMessage], ...]] = _EVERYTHING
    keeps_all: ClassVar[bool] = False

    def build(self) -> LiveOutput:
        """Not yet opened."""
        return RosLiveOutput("ros1", _ros1_node, "ROS 1", Ros2Config())


def _ros1_node() -> Any:
    from posefuse.messages.ros1 import Ros1Node

    return Ros1Node("posefuse")


class RosLiveOutput:
    """Publishes to a node; detections and previews only while there is a subscriber.

    Stamps of detections and of expected poses are always real time: they are for other machines of the session.
    """

    def __init__(self, name: str, node: Callable[[], Any], where: str, config: Ros2Config) -> None:
        self.name, self.where = name, where
        self._make_node, self._config = node, config
        self._node: Any = None
        self._ros: Any = None
        # simulated time, where it is wanted
        self._clock: Any = None

    def take(self, message: LiveMessage) -> None:
        """See `LiveOutput`."""
        match message:
            case LiveStart():
                self._open(message)
            case LivePose():
                self._follow_clock(message.pose.t_ns)
                self._ros.step(message.pose, message.joints, message.stages_ns)
            case LiveExpected(pose=pose) if self._node.wanted(topics.EXPECTED):
                self._node.publish(topics.EXPECTED, message_from_pose(pose, {}, self._ros.world_frame), pose.t_ns)
            case LiveHealth():
                self._follow_clock(message.t_ns)
                self._ros.diagnose(message.t_ns, health_lines(message))
            case LivePreview():
                self._follow_clock(message.t_ns)
                publish_preview(self._node, replace(message, t_ns=message.t_ns + self._ros.epoch_offset_ns), self._ros.rig)
            case LiveJointCentres() if self._config.detections:
                self._node.publish(topics.JOINT_CENTRES, message_from_live_centres(message), message.t_ns)
            case LiveDetections(detections=view) if self._config.detections and self._node.wanted(topics.DETECTIONS):
                self._node.publish(topics.DETECTIONS, message_from_detections(view, message.stages_ns), view.t_ns)

    def close(self) -> None:
        """Leave the network."""
        if self._node is not None:
            self._node.close()

    def _open(self, start: LiveStart) -> None:
        self._node = self._make_node()
        self._ros = RosOutput(self._node, start.rig)
        if self._config.sim_time:
            from posefuse.messages.sim_time import ClockReader

            self._clock = ClockReader(self._node)
            self._clock.wait(_CLOCK_WITHIN_S)
            self._follow_clock(start.t_ns)
        self._ros.start(start.t_ns)

    def _follow_clock(self, t_ns: int) -> None:
        if self._clock is not None:
            self._clock.update()
            self._ros.epoch_offset_ns = self._clock.clock.sim_from_real(t_ns) - t_ns


def message_from_live_centres(centres: LiveJointCentres) -> Any:
    """`posefuse_msgs/JointCentres`."""
    return message_from_joint_centres(centres.cameras, centres.table, centres.t_ns)


def publish_preview(outlet: topics.Outlet, preview: LivePreview, rig: Rig) -> None:
    """A small image on its camera's topic and the intrinsics of that size with the same stamp, while there is a subscriber."""
    topic, info = topics.preview(preview.camera), topics.preview_info(preview.camera)
    if outlet.wanted(topic):
        msg = message(
            topic.type_name,
            header=header(preview.t_ns, optical_frame(preview.camera)),
            format="rgb8; jpeg compressed bgr8",
            data=np.frombuffer(preview.jpeg, np.uint8),
        )
        outlet.publish(topic, msg, preview.t_ns)
    if outlet.wanted(info):
        camera = rig[preview.camera].scaled(preview.size_wh)
        outlet.publish(info, info_from_camera(camera, preview.t_ns), preview.t_ns)


def health_lines(health: LiveHealth) -> list[Health]:
    """One line of ROS diagnostics per camera and per output."""
    cameras = [
        Health(f"camera {name}", _LEVELS.get(camera.state, _ERROR), camera.text or camera.state, _shown(camera.figures))
        for name, camera in health.cameras.items()
    ]
    return cameras + [_output_line(name, output) for name, output in health.outputs.items()]


def _output_line(name: str, output: OutputHealth) -> Health:
    """An output that failed and continues stays a warning: a part of what it wrote is missing."""
    level, text = _LEVELS.get(output.state, _ERROR), output.text or output.state
    if level == _OK and output.failures:
        level, text = _WARNING, f"continues after {output.failures} failures, the last: {output.fault}"
    figures = {"taken": output.taken, "dropped": output.dropped, "failures": output.failures}
    return Health(f"output {name}", level, text, {**_shown(figures), "where": output.where})


def _shown(figures: Any) -> dict[str, str]:
    return {name: f"{value:g}" for name, value in figures.items()}
