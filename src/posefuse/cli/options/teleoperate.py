"""Options of `posefuse teleoperate`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter

from .shared import OUTPUTS, positive

HAND, ROBOT = Group.create_ordered("Hand"), Group.create_ordered("Robot")
ROBOT_ROS = Group.create_ordered("Robot over ROS")

# coordinates may begin with a minus
_ONE_WORD: Any = {"n_tokens": 1, "accepts_keys": False, "allow_leading_hyphen": True}


def _numbers(count: int, what: str) -> Any:
    """Converter of `count` numbers separated by commas or spaces."""

    def convert(_: object, tokens: Any) -> tuple[float, ...]:
        text = tokens[0].value
        try:
            found = tuple(float(part) for part in text.replace(",", " ").split())
        except ValueError:
            found = ()
        if len(found) != count or not all(abs(one) < 1e6 for one in found):
            raise ValueError(f"expected {what}, got {text!r}")
        return found

    return convert


@Parameter(name="*", group=HAND)
@dataclass(frozen=True, kw_only=True)
class HandOptions:
    """Which hand, and how its motion is used."""

    hand: Literal["right", "left", "both"] | None = None
    """The hand that the robot follows; both move a robot with two arms (default right)."""
    deadman: Annotated[str, Parameter(metavar="SWITCH")] = "key"
    """key (space bar), joystick:/dev/input/js0, ros:/joy, web[:PORT] (a page with a button), gesture (the other hand raised)."""
    scale: Annotated[float | None, positive(10)] = None
    """Metres of the robot per metre of the hand (default 1)."""
    turn: Annotated[float | None, Parameter(metavar="DEG")] = None
    """Turn of the robot's motion about the vertical, e.g. 180 for an operator who faces the robot (default 0)."""
    orientation: Literal["none", "forearm"] | None = None
    """Turn the end effector as the forearm turns (default none)."""
    i_have_an_emergency_stop: bool = False
    """An emergency stop of the robot is within reach: lets a gesture move a robot over ROS."""


@Parameter(name="*", group=ROBOT)
@dataclass(frozen=True, kw_only=True)
class RobotOptions:
    """Which robot, its position and its limits."""

    robot: Annotated[str, Parameter(metavar="sim|FILE.xml")] = "sim"
    """Our own mobile manipulator, or an MJCF model with position actuators."""
    frame: Annotated[tuple[str, ...], Parameter(metavar="SITE")] = ()
    """Site (with --command pose or twist: tf frame) of the end effector, one per hand (default right_hand, left_hand)."""
    robot_at: Annotated[
        tuple[float, float, float] | None,
        Parameter(metavar="X,Y,DEG", converter=_numbers(3, "X,Y,DEG"), **_ONE_WORD),
    ] = None
    """Where the robot's base frame stands in the world of the rig, m and degrees (default 0,0,0)."""
    elsewhere: bool = False
    """The robot is not in the operator's room: no separation is kept. Wrong for a robot that any person can reach."""
    box: Annotated[
        tuple[float, float, float, float, float, float] | None,
        Parameter(metavar="X0,Y0,Z0,X1,Y1,Z1", converter=_numbers(6, "X0,Y0,Z0,X1,Y1,Z1"), **_ONE_WORD),
    ] = None
    """Corners of the workspace of the end effector, world axes, m (default -10,-10,0.05,10,10,2)."""
    speed: Annotated[float | None, Parameter(metavar="M/S"), positive(2)] = None
    """Speed limit of the end effector (default 0.5)."""
    limits: Annotated[Path | None, Parameter(metavar="FILE.toml")] = None
    """All settings of teleoperation, see docs/teleoperation.md; an option that is given overrides the file."""
    view: bool = False
    """Open MuJoCo's viewer."""
    view_scene: bool = False
    """Show operator, robot, workspace and keep-out in the Rerun viewer (extra: viewer)."""
    view_file: Annotated[Path | None, Parameter(metavar="FILE.rrd")] = None
    """Write what that viewer would show to a file."""
    record: Annotated[Path | None, Parameter(metavar="FILE.mcap", group=OUTPUTS)] = None
    """Record views and poses; the robot's commands and states go to FILE.robot.mcap."""


@Parameter(name="*", group=ROBOT_ROS)
@dataclass(frozen=True, kw_only=True)
class RosRobotOptions:
    """A real robot over ROS, and what is shown there."""

    ros: bool = False
    """Publish state, target, box and keep-out in ROS 2; with --command, drive a robot."""
    ros1: bool = False
    """The same in ROS 1, at the master of ROS_MASTER_URI; the mobile base takes Twist."""
    command: Literal["pose", "twist", "joints"] | None = None
    """What the robot is sent: target poses, velocities, or joints by our own inverse kinematics (with --robot FILE.xml)."""
    base_frame: Annotated[str, Parameter(metavar="FRAME")] = "base_link"
    """tf frame that commands are given in."""
    controller: Annotated[str, Parameter(metavar="TOPIC")] = "/joint_trajectory_controller/joint_trajectory"
    """Topic of the joints: trajectory_msgs/JointTrajectory, or std_msgs/Float64MultiArray where it ends in /commands."""
    cmd_vel: Annotated[str, Parameter(metavar="TOPIC")] = ""
    """Topic of the mobile base."""
    cmd_vel_twist: bool = False
    """The mobile base takes Twist (ROS 2 Humble and older), not TwistStamped."""
