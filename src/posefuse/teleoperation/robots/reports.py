"""What the robot's side shows of itself: states, targets, limits, as ROS messages to a network or a file."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from posefuse.messages.topics import Outlet
from posefuse.teleoperation.settings import TeleoperationSettings
from posefuse.teleoperation.values import Order, RobotState


@dataclass(frozen=True, kw_only=True)
class RosPlan:
    """Where ROS is and how the robot's topics are named.

    Attributes:
        version: 2, or 1 for the master that ROS_MASTER_URI names.
        domain_id, local_only, interface, peers: see `messages.dds_domain.Network`.
        namespace: of our own topics. base_frame: tf frame that commands are given in. world_frame: of markers.
        controller: topic of `trajectory_msgs/JointTrajectory` or, ending in ``/commands``, of `std_msgs/Float64MultiArray`.
        cmd_vel: topic of the base's velocity; empty: none. stamped: it is a TwistStamped (ROS 2 Jazzy and later).
        joint_states: topic of the robot's joints.
    """

    version: int = 2
    domain_id: int = 0
    local_only: bool = False
    interface: str = ""
    peers: tuple[str, ...] = ()
    namespace: str = "/posefuse/teleoperation"
    base_frame: str = "base_link"
    world_frame: str = "world"
    controller: str = "/joint_trajectory_controller/joint_trajectory"
    cmd_vel: str = ""
    stamped: bool = True
    joint_states: str = "/joint_states"

    def node(self, name: str) -> Any:
        """An open node; raises DependencyError or SourceError where there is no ROS to talk to."""
        if self.version == 1:
            from posefuse.messages.ros1 import Ros1Node

            return Ros1Node(name)
        from posefuse.messages.dds import RosNode
        from posefuse.messages.dds_domain import Network

        network = Network(domain_id=self.domain_id, local_only=self.local_only, interface=self.interface, peers=self.peers)
        return RosNode(name, network)


class OutletReporter:
    """States as ROS messages to a node or a recording, see `robot_messages`."""

    def __init__(self, open_outlet: Callable[[], Outlet], settings: TeleoperationSettings, plan: RosPlan) -> None:
        from .robot_messages import StateMessages

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
