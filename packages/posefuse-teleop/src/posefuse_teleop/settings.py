"""What a user may set about teleoperation, and the limits that no file changes: each with its unit and its source.

Where ROS is (`RosPlan`) is stated here without importing it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal

from annotated_types import Ge, Gt, Le

from posefuse.core.extras import package_of_extra
from posefuse.foundation.settings import settings

if TYPE_CHECKING:
    from posefuse_ros.dds_domain import Network

Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]
# bounds that no robot near people needs to exceed: what is above them was meant in mm or ms
Reaction = Annotated[float, Gt(0), Le(0.5)]
Speed = Annotated[float, Gt(0), Le(5)]
Corner = tuple[float, float, float]

# without a heartbeat of the dead-man's switch for so long: HOLD; so many in a row before a press counts
HEARTBEAT_S, BEATS_TO_ENGAGE = 0.1, 3
# fewer cameras than this that see the hand: half speed, as the pose depends on each of them
FULL_VIEWS = 3
# the newest report of the cameras, and the newest state of the robot, may be so old
HEALTH_S, ROBOT_AGE_S = 1.0, 0.1
# clocks may differ by so much, and poses that are predicted to the next output tick be ahead
AHEAD_S = 0.05
# everything must be in order for so long before the robot moves (again); what is lost for longer needs a new press
SETTLE_S, REENGAGE_S = 0.1, 0.5
# a robot slower than this stands
STANDING_MPS = 1e-3
# a step of the hand so small is never rejected
HAND_STEP_M = 0.03
# left and right wrist nearer than this can be mistaken for each other: HOLD
HANDS_APART_M = 0.1
# lengths of forearm and trunk may differ by such shares from their running means, else it is another body or hand
FOREARM_SHARE, TRUNK_SHARE = 0.35, 0.2
# bones of the skeleton count as capsules of this radius
LIMB_RADIUS_M = 0.08
# noise of a resting hand's place, root mean square, that is smoothed away at most: of rendered operators
REST_NOISE_M = 0.005
# jerk of an end effector, and angular acceleration and jerk of its orientation: for comfort, braking knows no jerk limit
JERK_MPS3 = 60.0
TURN_ACCELERATION_RADPS2, TURN_JERK_RADPS3 = 5.0, 120.0
# condition number of the Jacobian where motions towards a singularity slow down, and where they stop: MoveIt Servo's defaults
SLOW_CONDITION, STOP_CONDITION = 17.0, 30.0


@settings
class MappingSettings:
    """From the hand to the target, whose orientation stays that of the end effector.

    Attributes:
        scale: metres of the target per metre of the hand.
        turn_deg: the robot's axes against the operator's, about the vertical: 0 moves the target as the hand moves in the
            world, 180 suits an operator who faces the robot like a mirror image.
        lead_m: the target is never farther than this ahead of the commanded position, which prevents wind-up.
    """

    scale: Annotated[float, Gt(0), Le(10)] = 1.0
    turn_deg: float = 0.0
    lead_m: Positive = 0.15


@settings
class LimitSettings:
    """What the robot may do, whatever is commanded.

    Attributes:
        speed_mps, acceleration_mps2: of an end effector, braking too. turn_rate_radps: of its orientation.
        box_low_m, box_high_m: corners of the workspace of every end effector, world axes.
        joint_margin_rad: joints stay so far from their limits (MoveIt Servo's default).
        joint_speed_radps, joint_acceleration_radps2: of the arm's joints: one value for all, or one for each in the order of the
            model. libfranka has 7.5 to 20 rad/s2, MoveIt's configuration of a UR 5.
        base_speed_mps, base_acceleration_mps2: of the mobile base, and in rad of its turn.
        collision_m: distance that the robot keeps between its own bodies, and from the floor.
    """

    speed_mps: Speed = 0.5
    acceleration_mps2: Positive = 2.5
    turn_rate_radps: Positive = 1.0
    box_low_m: Corner = (-10.0, -10.0, 0.05)
    box_high_m: Corner = (10.0, 10.0, 2.0)
    joint_margin_rad: NotNegative = 0.1
    joint_speed_radps: Positive | tuple[Positive, ...] = 2.5
    joint_acceleration_radps2: Positive | tuple[Positive, ...] = 10.0
    base_speed_mps: Speed = 0.3
    base_acceleration_mps2: Positive = 1.5
    collision_m: NotNegative = 0.02


@settings
class SeparationSettings:
    """Distance between the robot and the operator's own tracked body.

    Attributes:
        slow_m, stop_m: the speed limit falls linearly between them, to nothing.
        sigmas: so many standard deviations of a keypoint count as nearer.
        approach_mps: any part of the body may have come nearer at this speed since it was measured: that of the fastest hand that
            is accepted (`GateSettings.hand_speed_mps`). ISO 13855 has 2.0 m/s for reaching and 1.6 m/s for walking.
    """

    slow_m: Positive = 0.8
    stop_m: Positive = 0.4
    sigmas: NotNegative = 2.0
    approach_mps: NotNegative = 3.0


@settings
class GateSettings:
    """When the robot may follow the hand.

    Attributes:
        pose_age_s: the newest measurement of the hand may be so old.
        slow_sigma_m, hold_sigma_m: stated standard deviation of the hand in its worst direction: the speed limit falls linearly
            between them, then HOLD.
        least_views: cameras that see the hand: fewer is HOLD. least_cameras: of healthy cameras.
        hand_speed_mps: a hand that moved faster than this has not moved, it is another measurement: rejected, HOLD.
    """

    pose_age_s: Reaction = 0.12
    slow_sigma_m: Positive = 0.03
    hold_sigma_m: Positive = 0.06
    least_views: Annotated[int, Ge(1)] = 2
    least_cameras: Annotated[int, Ge(1)] = 2
    hand_speed_mps: Positive = 3.0


@settings
class RobotSettings:
    """The robot's side.

    Attributes:
        rate_hz: control rate; more is not kept up with, as each step checks a whole stop.
        watchdog_s: without an order for this time the robot stops by itself.
        position_xy_m, heading_deg: where the robot's base frame lies in the world of the rig.
        shared: the robot is in the operator's room. False switches the separation off: use it only for a robot elsewhere.
    """

    rate_hz: Annotated[float, Ge(20), Le(250)] = 100.0
    watchdog_s: Reaction = 0.06
    position_xy_m: tuple[float, float] = (0.0, 0.0)
    heading_deg: float = 0.0
    shared: bool = True


@settings
class TeleoperationSettings:
    """Everything about teleoperation. hands: which ones, in the order of the robot's frames."""

    hands: tuple[Literal["left", "right"], ...] = ("right",)
    mapping: MappingSettings = field(default_factory=MappingSettings)
    gate: GateSettings = field(default_factory=GateSettings)
    separation: SeparationSettings = field(default_factory=SeparationSettings)
    limits: LimitSettings = field(default_factory=LimitSettings)
    robot: RobotSettings = field(default_factory=RobotSettings)


@dataclass(frozen=True, kw_only=True)
class RosPlan:
    """Where ROS is and how the robot's topics are named.

    Attributes:
        network: of ROS 2; None: domain 0.
        base_frame: tf frame of commands.
        controller: topic of `trajectory_msgs/JointTrajectory`.
        cmd_vel: topic of the base's velocity; empty: none. stamped: it is a TwistStamped (ROS 2 Jazzy and later).
    """

    network: Network | None = None
    base_frame: str = "base_link"
    controller: str = "/joint_trajectory_controller/joint_trajectory"
    cmd_vel: str = ""
    stamped: bool = True

    @staticmethod
    def listening(ros: Mapping[str, Any]) -> RosPlan:
        """ROS 2 where a session with these options has it, see `posefuse.live`."""
        return RosPlan(network=package_of_extra("posefuse_ros.dds_domain", "ros").network_of(ros))

    def node(self, name: str) -> Any:
        """An open node; raises DependencyError or SourceError where there is no ROS to talk to."""
        dds = package_of_extra("posefuse_ros.dds", "ros")
        return dds.RosNode(name, self.network or dds.Network())
