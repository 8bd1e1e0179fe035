"""`posefuse live`: cameras in, 3D skeletons out 100 times a second."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from posefuse.cli.options.live import LiveSettingsOptions, OutputOptions, SourceOptions, TimingOptions
from posefuse.cli.options.shared import Figures, Ros2Options, Shown


def live(
    rig: Path,
    /,
    *,
    sources: SourceOptions = SourceOptions(),
    timing: TimingOptions = TimingOptions(),
    outputs: OutputOptions = OutputOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveSettingsOptions = LiveSettingsOptions(),
    videos: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    replay: Annotated[Path | None, Parameter(metavar="FILE")] = None,
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
