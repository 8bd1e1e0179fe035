"""`posefuse teleoperate`: a robot follows the operator's hand."""

from __future__ import annotations

from pathlib import Path

from posefuse.cli.options.live import LiveSettingsOptions, SourceOptions, TimingOptions
from posefuse.cli.options.shared import Figures, Ros2Options, Shown
from posefuse.cli.options.teleoperate import HandOptions, RobotOptions, RosRobotOptions


def teleoperate(
    rig: Path,
    /,
    *,
    sources: SourceOptions = SourceOptions(),
    timing: TimingOptions = TimingOptions(),
    hand: HandOptions = HandOptions(),
    robot: RobotOptions = RobotOptions(),
    ros: RosRobotOptions = RosRobotOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveSettingsOptions = LiveSettingsOptions(),
    terminal: Shown,
) -> Figures:
    """Let a robot follow the operator's hand: simulated in MuJoCo, or over ROS. No certified safety function.

    The robot moves only while the dead-man's switch is held. Runs until the time is over, the sources end, or Ctrl-C.

    Args:
        rig: Calibration file of the cameras.
    """
    from posefuse.cli.teleoperating import run_teleoperation

    return run_teleoperation(rig, sources, timing, hand, robot, ros=ros, ros_2=ros_2, settings=settings, terminal=terminal)
