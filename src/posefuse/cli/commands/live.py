"""`posefuse live` and `node`: poses while they happen."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from posefuse.cli.command_options import LiveOptions, OutputOptions, SourceOptions, TimingOptions
from posefuse.cli.options import EXPERT, OUTPUTS, Figures, Ros2Options, Shown, settings_options
from posefuse.realtime.config import LiveConfig

_SHOWN = {"body": "body", "track.max_people": "people N", "names": "names A,B,...", "rate_hz": "rate HZ"}
_EXPERT = {"groups": "groups N", "camera_info": "camera-info"}
LIVE_SETTINGS = {**_SHOWN, **_EXPERT}


@settings_options("settings", LiveConfig, _EXPERT, show=False)
@settings_options("settings", LiveConfig, _SHOWN)
def live(
    rig: Path,
    /,
    *,
    sources: SourceOptions = SourceOptions(),
    timing: TimingOptions = TimingOptions(),
    outputs: OutputOptions = OutputOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveOptions = LiveOptions(),
    videos: Annotated[Path | None, Parameter(metavar="DIR", group=OUTPUTS)] = None,
    replay: Annotated[Path | None, Parameter(metavar="FILE"), EXPERT] = None,
    terminal: Shown,
) -> Figures:
    """Track live: cameras, streams, videos or the simulator in, 3D skeletons out 100 times a second.

    Runs until the time is over, the sources end, or Ctrl-C.

    Args:
        rig: Calibration file of the cameras.
        videos: Keep the cameras' videos in this folder, a session for posefuse track.
        replay: Feed a recording to the tracker again, and compare the poses.
    """
    from posefuse.cli.live import check_nothing_else, replay_session, run_session

    if replay is not None:
        check_nothing_else(sources, timing, outputs, ros_2, videos=videos)
        return replay_session(rig, replay, settings, terminal)
    return run_session(rig, sources, timing, outputs, ros_2, settings=settings, terminal=terminal, videos=videos)


@settings_options("settings", LiveConfig, LIVE_SETTINGS, show=False)
def node_camera(
    rig: Path,
    /,
    *,
    sources: SourceOptions = SourceOptions(),
    timing: TimingOptions = TimingOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveOptions = LiveOptions(),
    name: str = "1",
    terminal: Shown,
) -> Figures:
    """Capture and detect on this machine, and send 2D poses to the fusion node.

    Args:
        rig: Calibration file of all cameras, the same on every machine.
        name: Name of this node, different on every machine.
    """
    from posefuse.cli.nodes import camera_node

    return camera_node(rig, name, sources, timing, ros_2, settings=settings, terminal=terminal)


@settings_options("settings", LiveConfig, LIVE_SETTINGS, show=False)
def node_fusion(
    rig: Path,
    /,
    *,
    timing: TimingOptions = TimingOptions(),
    outputs: Annotated[OutputOptions, EXPERT] = OutputOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveOptions = LiveOptions(),
    terminal: Shown,
) -> Figures:
    """Turn the 2D poses of all camera nodes into 3D poses, and publish them in ROS 2.

    Args:
        rig: Calibration file of all cameras, the same on every machine.
    """
    from posefuse.cli.nodes import fusion_node

    return fusion_node(rig, timing, outputs, ros_2, settings, terminal)
