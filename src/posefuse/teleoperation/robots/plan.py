"""What the robot's process is to drive, and where."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from posefuse.teleoperation.settings import TeleoperationSettings


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


@dataclass(frozen=True, kw_only=True)
class RobotPlan:
    """What the process is to drive.

    Attributes:
        settings: limits and rates. model: MJCF file; None: our own robot. frames: site of each hand.
        command: None drives the model in MuJoCo; ``pose``, ``twist`` or ``joints`` drives a robot over ROS.
        ros: where ROS is; None: none. record: .mcap file of commands and states; None: none. view: open MuJoCo's viewer.
        scene: MJCF text instead of a file, e.g. with boxes to move.
    """

    settings: TeleoperationSettings
    model: Path | None = None
    frames: tuple[str, ...] = ("right_hand",)
    command: str | None = None
    ros: RosPlan | None = None
    record: Path | None = None
    view: bool = False
    scene: str | None = None
