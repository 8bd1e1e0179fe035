"""`posefuse teleoperate`: a robot follows the operator's hand."""

from pathlib import Path
from typing import Annotated

from posefuse.cli.command_options import ROBOT, LiveOptions, RobotOptions, RosRobotOptions, SourceOptions, TimingOptions
from posefuse.cli.options import EXPERT, Figures, Ros2Options, Shown, settings_options
from posefuse.realtime.config import LiveConfig
from posefuse.teleoperation.settings import TeleoperationSettings

from .live import LIVE_SETTINGS


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
