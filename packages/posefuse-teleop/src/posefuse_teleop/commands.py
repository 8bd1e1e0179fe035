"""`posefuse teleoperate`: a robot follows the operator's hand."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

import posefuse as pf
from posefuse.cli.live import LIVE_SETTINGS, LiveOptions, TimingOptions, exit_code
from posefuse.cli.options import (
    ONE_WORD,
    OUTPUTS,
    Figures,
    NamedSettings,
    Ros2Options,
    Shown,
    Sources,
    check_used,
    positive,
    settings_options,
)
from posefuse.cli.terminal import Terminal
from posefuse.core import ConfigError
from posefuse.core.extras import package_of_extra
from posefuse.realtime.config import LiveConfig
from posefuse_teleop.settings import RosPlan, TeleoperationSettings

if TYPE_CHECKING:
    from posefuse_teleop.session import Operator, Summary
    from posefuse_teleop.values import Order

HAND, ROBOT, ROBOT_ROS = map(Group.create_ordered, ("Hand", "Robot", "Robot over ROS"))


def comma_numbers(form: str) -> Parameter:
    """So many numbers separated by commas or spaces, as in ``X,Y,DEG``."""

    def convert(_: Any, tokens: Any) -> tuple[float, ...]:
        text = tokens[0].value
        try:
            found = tuple(float(part) for part in text.replace(",", " ").split())
        except ValueError:
            found = ()
        if len(found) != len(form.split(",")) or not all(abs(one) < 1e6 for one in found):
            raise ValueError(f"expected {form}, got {text!r}")
        return found

    return Parameter(metavar=form, converter=convert, **ONE_WORD)


Place, Box = comma_numbers("X,Y,DEG"), comma_numbers("X0,Y0,Z0,X1,Y1,Z1")


@dataclass(frozen=True, kw_only=True)
class RobotOptions(NamedSettings):
    """Which hand, which robot, its position and its limits.

    Attributes:
        hand: The hand that the robot follows; both move a robot with two arms (default right).
        deadman: web[:PORT] (a page with a button), ros:/joy.
        robot: Our own mobile manipulator, or an MJCF model with position actuators.
        frame: Site (with --command pose: tf frame) of the end effector, one per hand (default right_hand, left_hand).
        robot_at: Where the robot's base frame stands in the world of the rig, m and degrees (default 0,0,0).
        elsewhere: The robot is not in the operator's room: no separation is kept. Wrong for a robot that any person can reach.
        box: Corners of the workspace of the end effector, world axes, m (default -10,-10,0.05,10,10,2).
        speed: Speed limit of the end effector, m/s (default 0.5).
        limits: All settings of teleoperation, see docs/teleoperation.md; an option that is given overrides the file.
        view: Open MuJoCo's viewer.
        record: Record views and poses; the robot's commands and states go to FILE.robot.mcap.
    """

    hand: Annotated[Literal["right", "left", "both"] | None, Parameter(group=HAND)] = None
    deadman: Annotated[str, Parameter(metavar="SWITCH", group=HAND)] = "web"
    robot: Annotated[str, Parameter(metavar="sim|FILE.xml")] = "sim"
    frame: Annotated[tuple[str, ...], Parameter(metavar="SITE")] = ()
    robot_at: Annotated[tuple[float, float, float] | None, Place] = None
    elsewhere: bool = False
    box: Annotated[tuple[float, float, float, float, float, float] | None, Box] = None
    speed: Annotated[float | None, Parameter(metavar="M/S"), positive(2)] = None
    limits: Annotated[Path | None, Parameter(metavar="FILE.toml")] = None
    view: bool = False
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
        command: What the robot is sent: target poses, or joints by our own inverse kinematics (--robot FILE.xml).
        base_frame: tf frame that commands are given in.
        controller: Topic of joints (trajectory_msgs/JointTrajectory).
        cmd_vel: Topic of the mobile base.
        cmd_vel_twist: The mobile base takes Twist (ROS 2 Humble and older), not TwistStamped.
    """

    ros: bool = False
    command: Literal["pose", "joints"] | None = None
    base_frame: Annotated[str, Parameter(metavar="FRAME")] = RosPlan.base_frame
    controller: Annotated[str, Parameter(metavar="TOPIC")] = RosPlan.controller
    cmd_vel: Annotated[str, Parameter(metavar="TOPIC")] = ""
    cmd_vel_twist: bool = False


@settings_options("settings", LiveConfig, LIVE_SETTINGS)
@settings_options(
    "robot",
    TeleoperationSettings,
    {"mapping.scale": "scale", "mapping.turn_deg": "turn DEG"},
    ROBOT,
)
def teleoperate(
    rig: Path,
    /,
    *,
    source: Sources = (),
    timing: TimingOptions = TimingOptions(),
    robot: RobotOptions = RobotOptions(),
    ros: RosRobotOptions = RosRobotOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveOptions = LiveOptions(),
    terminal: Shown,
) -> Figures:
    """Let a robot follow the operator's hand: simulated in MuJoCo, or over ROS. No certified safety function.

    The robot moves only while the dead-man's switch is held. Runs until the time is over, the sources end, or Ctrl-C.

    Args:
        rig: Calibration file of the cameras.
    """
    from posefuse.pipeline.config import read_changed

    _check_used(robot, ros)
    if not source:
        raise ConfigError("--source: expected one per camera, e.g. --source cam1=usb:0, or --source sim:SESSION")
    plan = RosPlan(
        network=package_of_extra("posefuse_ros.dds_domain", "ros").Network(**ros_2.network) if ros.ros else None,
        base_frame=ros.base_frame,
        controller=ros.controller,
        cmd_vel=ros.cmd_vel,
        stamped=not ros.cmd_vel_twist,
    )
    with terminal.stages() as report:
        session = pf.live(
            rig,
            source,
            config=settings.config,
            settings=settings.changes,
            record=robot.record,
            ros=ros_2.settings,
            duration_s=timing.duration,
            loop_s=timing.loop,
            progress=report,
        )
        done = pf.teleoperate(
            session,
            deadman=robot.deadman,
            settings=read_changed(robot.limits, robot.changes, TeleoperationSettings),
            robot=robot.robot,
            frames=robot.frame,
            command=ros.command,
            ros=plan if ros.ros else None,
            view=robot.view,
            record=robot.record.with_suffix(".robot.mcap") if robot.record else None,
            watch=_News(terminal),
            progress=report,
        )
    code = exit_code(done, timing.duration, terminal)
    return {**_shown(done, terminal), "exit_code": code}


def _check_used(robot: RobotOptions, ros: RosRobotOptions) -> None:
    """Raise ConfigError for an option that nothing takes."""
    joints = ros.command == "joints"
    check_used(
        [
            ("--command", ros.command, ros.ros, "needs --ros"),
            ("--controller", ros.controller != RosPlan.controller, joints, "needs --command joints"),
            ("--cmd-vel", ros.cmd_vel, joints, "needs --command joints"),
            ("--cmd-vel-twist", ros.cmd_vel_twist, ros.cmd_vel, "needs --cmd-vel TOPIC"),
            ("--base-frame", ros.base_frame != RosPlan.base_frame, ros.command, "needs --command"),
            ("--robot", robot.robot != "sim", joints or not ros.command, f"--command {ros.command} knows no model of the robot"),
            ("--view", robot.view, not ros.command, "shows the simulated robot; RViz shows the one of --command"),
        ]
    )


class _News:
    """A line whenever the phase or its reason changes."""

    def __init__(self, terminal: Terminal) -> None:
        self._terminal, self._last = terminal, ""

    def __call__(self, operator: "Operator", order: "Order | None") -> None:
        gate = operator.gate
        reason = "".join("#" if c.isdigit() else c for c in gate.reason)
        if (line := f"{gate.phase.value} {reason}") != self._last:
            self._last = line
            self._terminal.note(f"{gate.phase.value.upper():8} {gate.reason}")


def _shown(done: "Summary", terminal: Terminal) -> Mapping[str, Any]:
    import numpy as np

    from posefuse.foundation.summary import Block, Facts, Heading, Note, Table

    total = max(1, sum(done.ticks.values()))
    shares = {phase: count / total for phase, count in done.ticks.items()}
    latency = np.array(done.latency_ms)
    p50, p95 = np.percentile(latency, [50, 95]) if len(latency) else (None, None)
    blocks: list[Block] = [
        Heading("time"),
        Table(["phase", "share %"], [[phase, 100 * share] for phase, share in shares.items()]),
    ]
    if done.reasons:
        rows = [[reason, count] for reason, count in done.reasons.most_common(8)]
        blocks += [Heading("what slowed it down or held it"), Table(["reason", "steps"], rows)]
    facts = {
        "seconds": done.seconds,
        "times engaged": done.engagements,
        "mid-exposure to command, p50 ms": p50,
        "p95 ms": p95,
        "late control steps of the robot": done.robot_late,
    }
    problems = [done.fault, "" if done.people else "no person was tracked"]
    notes = [Note(text, warning=True) for text in problems if text]
    terminal.show([*blocks, Heading("session"), Facts(facts), *notes])
    return {
        "phases": shares,
        "reasons": dict(done.reasons),
        "engagements": done.engagements,
        "latency_p50_ms": p50,
        "latency_p95_ms": p95,
        "robot_late": done.robot_late,
        "seconds": done.seconds,
        "stopped_by": done.stopped_by,
        "failed": done.failed,
    }
