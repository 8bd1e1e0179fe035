"""What the robot's side shows of itself: states, targets, limits, as ROS messages to a network or a file."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import SE3
from posefuse.messages.body_messages import point_stamped, pose_stamped
from posefuse.messages.markers import solid_marker
from posefuse.messages.messages import header
from posefuse.messages.topics import DIAGNOSTICS, Outlet, Topic
from posefuse.messages.types import message
from posefuse.teleoperation.settings import TeleoperationSettings
from posefuse.teleoperation.values import Order, Phase, RobotState

from .plan import RosPlan

_OK, _WARNING, _ERROR = 0, 1, 2
_LEVELS = {Phase.ENGAGED: _OK, Phase.READY: _OK, Phase.IDLE: _OK, Phase.HOLD: _WARNING, Phase.STOPPED: _ERROR}
_MARKERS_EVERY_NS, _DIAGNOSTICS_EVERY_NS = 50_000_000, 200_000_000


class StateMessages:
    """Messages of each control step, on topics in `namespace`; markers and diagnostics not at every one."""

    def __init__(self, settings: TeleoperationSettings, namespace: str, world_frame: str) -> None:
        self._settings, self._frame = settings, world_frame
        name = namespace.rstrip("/")
        self._targets = [Topic(f"{name}/{side}/target_pose", "geometry_msgs/msg/PoseStamped", depth=1) for side in settings.hands]
        self._commanded = [Topic(f"{name}/{side}/commanded", "geometry_msgs/msg/PoseStamped", depth=1) for side in settings.hands]
        self._measured = [Topic(f"{name}/{side}/measured", "geometry_msgs/msg/PointStamped", depth=1) for side in settings.hands]
        self._engaged = Topic(f"{name}/engaged", "std_msgs/msg/Bool", depth=1)
        self._markers = Topic(f"{name}/markers", "visualization_msgs/msg/MarkerArray", depth=1)
        self._marked_ns = self._diagnosed_ns = 0

    def of(
        self, state: RobotState, order: Order | None, t_ns: int, wanted: Callable[[Topic], bool]
    ) -> Iterator[tuple[Topic, Any]]:
        """Topics and messages of one step that a person wants; `t_ns` in Unix time."""
        phase = order.phase if order is not None else Phase.IDLE
        if wanted(self._engaged):
            yield self._engaged, message("std_msgs/msg/Bool", data=phase is Phase.ENGAGED)
        for h in range(len(self._targets)):
            if order is not None and phase is Phase.ENGAGED and wanted(self._targets[h]):
                yield self._targets[h], pose_stamped(t_ns, self._frame, SE3(order.wxyz[h], order.xyz_world[h]))
            if wanted(self._commanded[h]):
                yield self._commanded[h], pose_stamped(t_ns, self._frame, SE3(state.wxyz[h], state.xyz_world[h]))
            if wanted(self._measured[h]):
                yield self._measured[h], point_stamped(t_ns, self._frame, state.measured_xyz_world[h])
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
                t_ns, self._frame, "box", 0, shape="cube", xyz=(low + high) / 2, size_m=high - low, rgba=(0.2, 0.6, 1.0, 0.08)
            )
        ]
        keep_out_m = 2 * self._settings.separation.stop_m
        for i, sphere in enumerate(state.spheres_world):
            size, rgba = np.full(3, keep_out_m + 2 * sphere[3]), (1.0, 0.3, 0.1, 0.03)
            found.append(solid_marker(t_ns, self._frame, "keep_out", i, shape="sphere", xyz=sphere[:3], size_m=size, rgba=rgba))
        if order is not None and order.phase is Phase.ENGAGED:
            for h, target in enumerate(order.xyz_world):
                size, rgba = np.full(3, 0.05), (0.1, 0.8, 0.2, 0.9)
                found.append(solid_marker(t_ns, self._frame, "target", h, shape="sphere", xyz=target, size_m=size, rgba=rgba))
        return message("visualization_msgs/msg/MarkerArray", markers=found)

    def _diagnostics(self, state: RobotState, order: Order | None, phase: Phase, t_ns: int) -> Any:
        values = {
            "reason": order.reason if order is not None else "no order yet",
            "speed limit m/s": f"{order.speed_mps:.3f}" if order is not None else "0",
            "robot": state.fault or state.limited or "follows",
            "late control steps": str(state.late),
        }
        status = message(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=_ERROR if state.fault else _LEVELS[phase],
            name="posefuse: teleoperation",
            message=phase.value,
            hardware_id="",
            values=[message("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()],
        )
        return message("diagnostic_msgs/msg/DiagnosticArray", header=header(t_ns, ""), status=[status])


class OutletReporter:
    """States as ROS messages to a node or a recording, see `StateMessages`."""

    def __init__(self, open_outlet: Callable[[], Outlet], settings: TeleoperationSettings, plan: RosPlan) -> None:
        self._outlet: Any = open_outlet()
        self._messages = StateMessages(settings, plan.namespace, plan.world_frame)
        # monotonic clock to Unix epoch, once: stamps must not jump
        self._offset_ns = time.time_ns() - time.monotonic_ns()

    def take(self, state: RobotState, order: Order | None) -> None:
        """Show the state after a control step."""
        t_ns = state.sent_ns + self._offset_ns
        for topic, msg in self._messages.of(state, order, t_ns, self._outlet.wanted):
            self._outlet.publish(topic, msg, t_ns)

    def close(self) -> None:
        """Finish; safe to call twice."""
        self._outlet.close()


def open_reporters(ros: RosPlan | None, record: Path | None, settings: TeleoperationSettings) -> list[OutletReporter]:
    """Reporters of a plan; raises PosefuseError where one cannot be opened."""
    found: list[OutletReporter] = []
    if ros is not None:
        found.append(OutletReporter(lambda: ros.node("posefuse_teleoperation"), settings, ros))
    if record is not None:
        from posefuse.messages.bags import Recorder

        found.append(OutletReporter(lambda: Recorder(record), settings, ros or RosPlan()))
    return found
