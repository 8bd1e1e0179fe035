"""Where ROS is for teleoperation, without importing it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from posefuse.core.extras import package_of_extra

if TYPE_CHECKING:
    from posefuse_ros.dds_domain import Network


@dataclass(frozen=True, kw_only=True)
class RosPlan:
    """Where ROS is and how the robot's topics are named.

    Attributes:
        version: 2, or 1 for the master that ROS_MASTER_URI names. network: of ROS 2; None: domain 0.
        base_frame: tf frame of commands.
        controller: topic of `trajectory_msgs/JointTrajectory` or, ending in ``/commands``, of `std_msgs/Float64MultiArray`.
        cmd_vel: topic of the base's velocity; empty: none. stamped: it is a TwistStamped (ROS 2 Jazzy and later).
    """

    version: int = 2
    network: Network | None = None
    base_frame: str = "base_link"
    controller: str = "/joint_trajectory_controller/joint_trajectory"
    cmd_vel: str = ""
    stamped: bool = True

    def node(self, name: str) -> Any:
        """An open node; raises DependencyError or SourceError where there is no ROS to talk to."""
        if self.version == 1:
            return package_of_extra("posefuse_ros.ros1", "ros").Ros1Node(name)
        dds = package_of_extra("posefuse_ros.dds", "ros")
        return dds.RosNode(name, self.network or dds.Network())
