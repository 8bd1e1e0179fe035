"""`posefuse teleoperate`: a robot follows the operator's hand."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Group, Parameter

from posefuse.cli.options import (
    EXPERT,
    OUTPUTS,
    Figures,
    Options,
    Ros2Options,
    Shown,
    numbers,
    positive,
    settings_options,
)
from posefuse.realtime.config import LiveConfig
from posefuse.teleoperation.settings import TeleoperationSettings

from .live import LIVE_SETTINGS, LiveOptions, SourceOptions, TimingOptions

HAND, ROBOT, ROBOT_ROS = map(Group.create_ordered, ("Hand", "Robot", "Robot over ROS"))
Place, Box = numbers("X,Y,DEG"), numbers("X0,Y0,Z0,X1,Y1,Z1")


@dataclass(frozen=True, kw_only=True)
class RobotOptions(Options):
    """Which hand, which robot, its position and its limits.

    Attributes:
        hand: The hand that the robot follows; both move a robot with two arms (default right).
        deadman: key (space bar), joystick:/dev/input/js0, ros:/joy, web[:PORT] (a page with a button), gesture (the other hand
            raised).
        i_have_an_emergency_stop: An emergency stop of the robot is within reach: lets a gesture move a robot over ROS.
        robot: Our own mobile manipulator, or an MJCF model with position actuators.
        frame: Site (with --command pose or twist: tf frame) of the end effector, one per hand (default right_hand, left_hand).
        robot_at: Where the robot's base frame stands in the world of the rig, m and degrees (default 0,0,0).
        elsewhere: The robot is not in the operator's room: no separation is kept. Wrong for a robot that any person can reach.
        box: Corners of the workspace of the end effector, world axes, m (default -10,-10,0.05,10,10,2).
        speed: Speed limit of the end effector, m/s (default 0.5).
        limits: All settings of teleoperation, see docs/teleoperation.md; an option that is given overrides the file.
        view: Open MuJoCo's viewer.
        view_scene: Show operator, robot, workspace and keep-out in the Rerun viewer (extra: viewer).
        view_file: Write what that viewer would show to a file.
        record: Record views and poses; the robot's commands and states go to FILE.robot.mcap.
    """

    hand: Annotated[Literal["right", "left", "both"] | None, Parameter(group=HAND)] = None
    deadman: Annotated[str, Parameter(metavar="SWITCH", group=HAND)] = "key"
    i_have_an_emergency_stop: Annotated[bool, Parameter(group=HAND)] = False
    robot: Annotated[str, Parameter(metavar="sim|FILE.xml")] = "sim"
    frame: Annotated[tuple[str, ...], Parameter(metavar="SITE")] = ()
    robot_at: Annotated[tuple[float, float, float] | None, Place] = None
    elsewhere: bool = False
    box: Annotated[tuple[float, float, float, float, float, float] | None, Box] = None
    speed: Annotated[float | None, Parameter(metavar="M/S"), positive(2)] = None
    limits: Annotated[Path | None, Parameter(metavar="FILE.toml")] = None
    view: bool = False
    view_scene: Annotated[bool, EXPERT] = False
    view_file: Annotated[Path | None, Parameter(metavar="FILE.rrd"), EXPERT] = None
    record: Annotated[Path | None, Parameter(metavar="FILE.mcap", group=OUTPUTS)] = None

    @property
    def changes(self) -> dict[str, Any]:
        """Those of options that are several settings, too."""
        *place, heading_deg = self.robot_at or (None,)
        both = ("right", "left") if self.hand == "both" else (self.hand,)
        more = {
            "hands": both if self.hand else None,
            "robot.position_xy_m": place or None,
            "robot.heading_deg": heading_deg,
            "robot.shared": False if self.elsewhere else None,
            "limits.box_low_m": self.box and self.box[:3],
            "limits.box_high_m": self.box and self.box[3:],
            "limits.speed_mps": self.speed,
        }
        return {**super().changes, **{key: value for key, value in more.items() if value is not None}}


@Parameter(name="*", group=ROBOT_ROS)
@dataclass(frozen=True, kw_only=True)
class RosRobotOptions:
    """A real robot over ROS, and what is shown there.

    Attributes:
        ros: Publish state, target, box and keep-out in ROS 2; with --command, drive a robot.
        ros1: The same in ROS 1, at the master of ROS_MASTER_URI; the mobile base takes Twist.
        command: What the robot is sent: target poses, velocities, or joints by our own inverse kinematics (--robot FILE.xml).
        base_frame: tf frame that commands are given in.
        controller: Topic of joints: trajectory_msgs/JointTrajectory, or std_msgs/Float64MultiArray where it ends in /commands.
        cmd_vel: Topic of the mobile base.
        cmd_vel_twist: The mobile base takes Twist (ROS 2 Humble and older), not TwistStamped.
    """

    ros: bool = False
    ros1: Annotated[bool, EXPERT] = False
    command: Literal["pose", "twist", "joints"] | None = None
    base_frame: Annotated[str, Parameter(metavar="FRAME"), EXPERT] = "base_link"
    controller: Annotated[str, Parameter(metavar="TOPIC"), EXPERT] = "/joint_trajectory_controller/joint_trajectory"
    cmd_vel: Annotated[str, Parameter(metavar="TOPIC"), EXPERT] = ""
    cmd_vel_twist: Annotated[bool, EXPERT] = False


@settings_options("settings", LiveConfig, LIVE_SETTINGS, show=False)
@settings_options(
    "robot",
    TeleoperationSettings,
    {"mapping.scale": "scale", "mapping.turn_deg": "turn DEG", "mapping.orientation": "orientation"},
    ROBOT,
)
def teleoperate(
    rig: Path,
    /,
    *,
    sources: SourceOptions = SourceOptions(),
    timing: TimingOptions = TimingOptions(),
    robot: RobotOptions = RobotOptions(),
    ros: RosRobotOptions = RosRobotOptions(),
    ros_2: Annotated[Ros2Options, EXPERT] = Ros2Options(),
    settings: LiveOptions = LiveOptions(),
    terminal: Shown,
) -> Figures:
    """Let a robot follow the operator's hand: simulated in MuJoCo, or over ROS. No certified safety function.

    The robot moves only while the dead-man's switch is held. Runs until the time is over, the sources end, or Ctrl-C.

    Args:
        rig: Calibration file of the cameras.
    """
    from posefuse.cli.teleoperating import run_teleoperation

    return run_teleoperation(rig, sources, timing, robot, ros, ros_2=ros_2, settings=settings, terminal=terminal)
