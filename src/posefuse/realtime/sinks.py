"""Ways out of a live session: recording, ROS 2, OSC and JSON datagrams. The viewer is in `viewer.py`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from posefuse.messages import topics
from posefuse.messages.messages import header, message_from_detections, message_from_pose, messages_from_joints, optical_frame
from posefuse.messages.osc import json_from_pose, osc_from_pose
from posefuse.messages.ros_output import Health, RosOutput, body_id
from posefuse.messages.types import message

from .joint_centres import message_from_centres
from .messages import Preview
from .outputs import NOTES, OutputPlan
from .viewer import ViewSink

__all__ = ["RecordSink", "RosSink", "UdpSink", "ViewSink"]

_LEVELS = {"ok": 0, "opening": 1, "flood": 1, "clock": 1, "late": 1, "bumped": 1, "out of step": 1}
_ERROR = 2
WORLD = "world"


class RecordSink:
    """Views and poses in the order the tracker took and gave them, so that a replay reproduces the session."""

    name, keeps_all = "record", True

    def __init__(self, plan: OutputPlan) -> None:
        from posefuse.messages.bags import Recorder

        assert plan.record is not None
        self._recorder = Recorder(plan.record)
        if plan.notes:
            self._recorder.note(NOTES, plan.notes)
        RosOutput(self._recorder, plan.rig).start(plan.clock.now_ns())

    def take(self, kind: str, values: Sequence[Any]) -> None:
        """See `LiveSink`."""
        if kind == "centres":
            t_ns, told = values
            self._recorder.publish(topics.JOINT_CENTRES, message_from_centres(told, t_ns), t_ns)
        elif kind == "view":
            view, stages = values
            self._recorder.publish(topics.DETECTIONS, message_from_detections(view, stages), view.t_ns)
        elif kind == "pose":
            pose, stages, joints = values
            self._recorder.publish(topics.POSE, message_from_pose(pose, stages, WORLD), pose.t_ns)
            for msg in messages_from_joints(joints, WORLD, pose.t_ns) if joints is not None else ():
                self._recorder.publish(topics.body(body_id(msg.person_id), "joint_angles"), msg, pose.t_ns)

    def close(self) -> None:
        """Finish the file."""
        self._recorder.close()


class RosSink:
    """ROS 2 topics, see docs/ros.md; previews only while somebody listens."""

    name, keeps_all = "ros", False

    def __init__(self, plan: OutputPlan) -> None:
        from posefuse.messages.dds import RosNode

        self._node, self._views = RosNode("posefuse", plan.ros), plan.ros_views
        self._output = RosOutput(self._node, plan.rig)
        self._output.start(plan.clock.now_ns())

    def take(self, kind: str, values: Sequence[Any]) -> None:
        """See `LiveSink`."""
        if kind == "pose":
            pose, stages, joints = values
            self._output.step(pose, joints, stages)
        elif kind == "centres" and self._views:
            t_ns, told = values
            self._node.publish(topics.JOINT_CENTRES, message_from_centres(told, t_ns), t_ns)
        elif kind == "view" and self._views and self._node.wanted(topics.DETECTIONS):
            view, stages = values
            self._node.publish(topics.DETECTIONS, message_from_detections(view, stages), view.t_ns)
        elif kind == "health":
            t_ns, states, rates = values
            self._output.diagnose(t_ns, health_lines(states, rates))
        elif kind == "preview":
            publish_preview(self._node, values[0])

    def close(self) -> None:
        """Leave the network."""
        self._node.close()


class UdpSink:
    """Poses as datagrams."""

    keeps_all = False

    def __init__(self, name: str, addresses: Sequence[str], axes: str) -> None:
        from posefuse.messages.osc import AXES
        from posefuse.messages.streams import UdpStream

        assert axes in AXES
        self.name, self._axes = name, axes
        self._packets: Callable[..., list[bytes]] = osc_from_pose if name == "osc" else json_from_pose
        self._stream = UdpStream(addresses)

    def take(self, kind: str, values: Sequence[Any]) -> None:
        """See `LiveSink`."""
        if kind == "pose":
            pose, _, joints = values
            self._stream.send(self._packets(pose, joints, self._axes))

    def close(self) -> None:
        """Close the socket."""
        self._stream.close()


def publish_preview(node: Any, preview: Preview) -> None:
    """A small picture on its camera's topic, while somebody listens."""
    topic = topics.preview(preview.camera)
    if node.writer(topic).readers():
        msg = message(
            topic.type_name,
            header=header(preview.t_ns, optical_frame(preview.camera)),
            format="rgb8; jpeg compressed bgr8",
            data=np.frombuffer(preview.jpeg, np.uint8),
        )
        node.publish(topic, msg, preview.t_ns)


def health_lines(states: dict[str, tuple[str, str]], rates: dict[str, dict[str, float]]) -> list[Health]:
    """One line of ROS diagnostics per camera."""
    lines = []
    for camera, (state, text) in states.items():
        values = {name: f"{value:g}" for name, value in rates.get(camera, {}).items()}
        lines.append(Health(f"camera {camera}", _LEVELS.get(state, _ERROR), text or state, values))
    return lines
