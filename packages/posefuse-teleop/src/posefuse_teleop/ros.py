"""What the robot's side shows of itself in ROS and in recordings: states, targets, limits."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import SE3
from posefuse_ros.bags import Recorder
from posefuse_ros.markers import solid_marker
from posefuse_ros.messages import diagnostic_status, header, point_stamped, pose_stamped
from posefuse_ros.topics import DIAGNOSTICS, Topic
from posefuse_ros.types import message

from .settings import RosPlan, TeleoperationSettings
from .values import Order, Phase, RobotState

# of our own topics
NAMESPACE = "/posefuse/teleoperation"
_WORLD = "world"

_OK, _WARNING, _ERROR = 0, 1, 2
_LEVELS = {Phase.ENGAGED: _OK, Phase.READY: _OK, Phase.IDLE: _OK, Phase.HOLD: _WARNING, Phase.STOPPED: _ERROR}
_MARKERS_EVERY_NS, _DIAGNOSTICS_EVERY_NS = 50_000_000, 200_000_000


class Reporter:
    """The state after each control step, as messages to a node or a recording; markers and diagnostics not at every step."""

    def __init__(self, outlet: Any, settings: TeleoperationSettings) -> None:
        self._outlet, self._settings = outlet, settings
        pose, point = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PointStamped"
        self._targets, self._commanded, self._measured = (
            [Topic(f"{NAMESPACE}/{side}/{name}", kind, depth=1) for side in settings.hands]
            for name, kind in (("target_pose", pose), ("commanded", pose), ("measured", point))
        )
        self._engaged = Topic(f"{NAMESPACE}/engaged", "std_msgs/msg/Bool", depth=1)
        self._markers = Topic(f"{NAMESPACE}/markers", "visualization_msgs/msg/MarkerArray", depth=1)
        self._marked_ns = self._diagnosed_ns = 0
        # monotonic clock to Unix epoch, once: stamps must not jump
        self._offset_ns = time.time_ns() - time.monotonic_ns()

    def take(self, state: RobotState, order: Order | None) -> None:
        """Show the state after a control step, to those who want it."""
        t_ns = state.sent_ns + self._offset_ns
        for topic, msg in self._messages(state, order, t_ns):
            self._outlet.publish(topic, msg, t_ns)

    def close(self) -> None:
        """Finish; safe to call twice."""
        self._outlet.close()

    def _messages(self, state: RobotState, order: Order | None, t_ns: int) -> Iterator[tuple[Topic, Any]]:
        phase, wanted = order.phase if order is not None else Phase.IDLE, self._outlet.wanted
        if wanted(self._engaged):
            yield self._engaged, message("std_msgs/msg/Bool", data=phase is Phase.ENGAGED)
        for h in range(len(self._targets)):
            if order is not None and phase is Phase.ENGAGED and wanted(self._targets[h]):
                yield self._targets[h], pose_stamped(t_ns, _WORLD, SE3(order.wxyz[h], order.xyz_world[h]))
            if wanted(self._commanded[h]):
                yield self._commanded[h], pose_stamped(t_ns, _WORLD, SE3(state.wxyz[h], state.xyz_world[h]))
            if wanted(self._measured[h]):
                yield self._measured[h], point_stamped(t_ns, _WORLD, state.measured_xyz_world[h])
        if t_ns - self._marked_ns >= _MARKERS_EVERY_NS and wanted(self._markers):
            self._marked_ns = t_ns
            yield self._markers, self._marker_array(state, order, t_ns)
        if t_ns - self._diagnosed_ns >= _DIAGNOSTICS_EVERY_NS and wanted(DIAGNOSTICS):
            self._diagnosed_ns = t_ns
            yield DIAGNOSTICS, self._diagnostics(state, order, phase, t_ns)

    def _marker_array(self, state: RobotState, order: Order | None, t_ns: int) -> Any:
        low, high = np.array(self._settings.limits.box_low_m), np.array(self._settings.limits.box_high_m)
        found = [
            solid_marker(
                t_ns, _WORLD, "box", 0, shape="cube", xyz=(low + high) / 2, size_m=high - low, rgba=(0.2, 0.6, 1.0, 0.08)
            )
        ]
        keep_out_m = 2 * self._settings.separation.stop_m
        for i, sphere in enumerate(state.spheres_world):
            size, rgba = np.full(3, keep_out_m + 2 * sphere[3]), (1.0, 0.3, 0.1, 0.03)
            found.append(solid_marker(t_ns, _WORLD, "keep_out", i, shape="sphere", xyz=sphere[:3], size_m=size, rgba=rgba))
        if order is not None and order.phase is Phase.ENGAGED:
            for h, target in enumerate(order.xyz_world):
                size, rgba = np.full(3, 0.05), (0.1, 0.8, 0.2, 0.9)
                found.append(solid_marker(t_ns, _WORLD, "target", h, shape="sphere", xyz=target, size_m=size, rgba=rgba))
        return message("visualization_msgs/msg/MarkerArray", markers=found)

    def _diagnostics(self, state: RobotState, order: Order | None, phase: Phase, t_ns: int) -> Any:
        values = {
            "reason": order.reason if order is not None else "no order yet",
            "speed limit m/s": f"{order.speed_mps:.3f}" if order is not None else "0",
            "robot": state.fault or state.limited or "follows",
            "late control steps": str(state.late),
        }
        level = _ERROR if state.fault else _LEVELS[phase]
        status = diagnostic_status("teleoperation", level, phase.value, values, hardware_id="")
        return message("diagnostic_msgs/msg/DiagnosticArray", header=header(t_ns, ""), status=[status])


def open_reporters(ros: RosPlan | None, record: Path | None, settings: TeleoperationSettings) -> list[Reporter]:
    """Reporters of a plan; raises PosefuseError where one cannot be opened."""
    outlets: list[Any] = [] if ros is None else [ros.node("posefuse_teleoperation")]
    outlets += [] if record is None else [Recorder(record)]
    return [Reporter(outlet, settings) for outlet in outlets]
