"""Live outputs ``ros2`` and ``ros1``: topics of docs/reference/messages.md, with or without an installed ROS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from posefuse.core import (
    LiveDetections,
    LiveExpected,
    LiveHealth,
    LiveJointCentres,
    LiveMessage,
    LiveNames,
    LiveOutput,
    LivePose,
    LivePreview,
    LiveStart,
    OutputHealth,
    Pose3D,
)
from posefuse.foundation.settings import settings

from . import topics
from .camera_messages import info_from_camera, message_from_joint_centres
from .dds import RosNode
from .dds_domain import NetworkSettings, require_tested_cyclonedds
from .messages import diagnostic_status, header, message_from_detections, message_from_names, message_from_pose, optical_frame
from .ros1 import Ros1Node
from .ros_output import RosOutput
from .sim_time import ClockReader
from .types import message

_OK, _WARNING, _ERROR = 0, 1, 2
_LEVELS = dict.fromkeys(("opening", "flood", "clock", "late", "overload", "moved", "unsynchronised", "hangs"), _WARNING) | {
    "ok": _OK
}
_EVERYTHING = (LiveDetections, LivePose, LiveExpected, LiveJointCentres, LiveHealth, LivePreview)


@settings
class Ros2Config(NetworkSettings):
    """ROS 2 topics over DDS; no ROS needed.

    Attributes:
        detections: publish 2D poses too; not where they came from ROS.
        sim_time: stamps are simulated time, from `/clock` (ROS: `use_sim_time`).
    """

    detections: bool = True
    sim_time: bool = False
    takes: ClassVar[tuple[type[LiveMessage], ...]] = _EVERYTHING
    keeps_all: ClassVar[bool] = False

    def build(self) -> LiveOutput:
        """Not yet opened; raises DependencyError without the extra `ros`."""
        require_tested_cyclonedds()
        return RosLiveOutput("ros2", lambda: RosNode("posefuse", self.network), f"ROS 2 domain {self.domain_id}", self)


@settings
class Ros1Config:
    """ROS 1 topics at the master that ROS_MASTER_URI names; needs rospy."""

    takes: ClassVar[tuple[type[LiveMessage], ...]] = _EVERYTHING
    keeps_all: ClassVar[bool] = False

    def build(self) -> LiveOutput:
        """Not yet opened."""
        return RosLiveOutput("ros1", lambda: Ros1Node("posefuse"), "ROS 1", Ros2Config())


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
            case LiveDetections() | LiveJointCentres() if not self._config.detections:
                pass
            case LivePose(pose=Pose3D(t_ns=t_ns)) | LiveHealth(t_ns=t_ns) | LivePreview(t_ns=t_ns):
                self._follow_clock(t_ns)
                publish(self._ros, message)
            case _:
                publish(self._ros, message)

    def close(self) -> None:
        """Leave the network."""
        if self._node is not None:
            self._node.close()

    def _open(self, start: LiveStart) -> None:
        self._node = self._make_node()
        self._ros = RosOutput(self._node, start.rig)
        if self._config.sim_time:
            self._clock = ClockReader(self._node)
            self._clock.wait()
            self._follow_clock(start.t_ns)
        self._ros.start(start.t_ns)

    def _follow_clock(self, t_ns: int) -> None:
        if self._clock is not None:
            self._clock.update()
            self._ros.epoch_offset_ns = self._clock.clock.sim_from_real(t_ns) - t_ns


def publish(output: RosOutput, message: LiveMessage) -> None:
    """What goes to ROS, or into a recording, of a message of a session, while it is wanted."""
    outlet = output.outlet
    match message:
        case LivePose():
            output.step(message.pose, message.joints, message.stages_ns)
        case LiveExpected(pose=pose) if outlet.wanted(topics.EXPECTED):
            outlet.publish(topics.EXPECTED, message_from_pose(pose, {}), pose.t_ns)
        case LiveHealth():
            output.diagnose(message.t_ns, health_lines(message))
        case LivePreview():
            _publish_preview(output, message)
        case LiveJointCentres():
            outlet.publish(topics.JOINT_CENTRES, message_from_joint_centres(message), message.t_ns)
        case LiveNames(names=names):
            outlet.publish(topics.NAMES, message_from_names(names), message.t_ns)
        case LiveDetections(detections=view) if outlet.wanted(topics.DETECTIONS):
            outlet.publish(topics.DETECTIONS, message_from_detections(view, message.stages_ns), view.t_ns)


def _publish_preview(output: RosOutput, preview: LivePreview) -> None:
    """A small image on its camera's topic and the intrinsics of that size with the same stamp, while there is a subscriber."""
    outlet, t_ns = output.outlet, preview.t_ns + output.epoch_offset_ns
    topic, info = topics.preview(preview.camera), topics.preview_info(preview.camera)
    if outlet.wanted(topic):
        msg = message(
            topic.type_name,
            header=header(t_ns, optical_frame(preview.camera)),
            format="rgb8; jpeg compressed bgr8",
            data=np.frombuffer(preview.jpeg, np.uint8),
        )
        outlet.publish(topic, msg, t_ns)
    if output.rig is not None and outlet.wanted(info):
        outlet.publish(info, info_from_camera(output.rig[preview.camera].scaled(preview.size_wh), t_ns), t_ns)


def health_lines(health: LiveHealth) -> list[Any]:
    """One line of ROS diagnostics per camera and per output."""
    cameras = [
        diagnostic_status(f"camera {name}", _LEVELS.get(one.state, _ERROR), one.text or one.state, _shown(one.figures))
        for name, one in health.cameras.items()
    ]
    return cameras + [_output_line(name, output) for name, output in health.outputs.items()]


def _output_line(name: str, output: OutputHealth) -> Any:
    """An output that failed and continues stays a warning: a part of what it wrote is missing."""
    level, text = _LEVELS.get(output.state, _ERROR), output.text or output.state
    if level == _OK and output.failures:
        level, text = _WARNING, f"continues after {output.failures} failures, the last: {output.fault}"
    figures = {"taken": output.taken, "dropped": output.dropped, "failures": output.failures}
    return diagnostic_status(f"output {name}", level, text, {**_shown(figures), "where": output.where})


def _shown(figures: Any) -> dict[str, str]:
    return {name: f"{value:g}" for name, value in figures.items()}
