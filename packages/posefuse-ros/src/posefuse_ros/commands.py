"""`posefuse node`: one session on several machines."""

from pathlib import Path

import posefuse as pf
from posefuse.cli.live import (
    LIVE_SETTINGS,
    LiveOptions,
    OutputOptions,
    TimingOptions,
    exit_code,
    how_it_ended,
)
from posefuse.cli.options import Figures, Ros2Options, Shown, Sources, settings_options
from posefuse.realtime.config import LiveConfig


@settings_options("settings", LiveConfig, LIVE_SETTINGS)
def node_camera(
    rig: Path,
    /,
    *,
    source: Sources = (),
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
    with terminal.stages() as progress:
        run = pf.camera_node(
            rig,
            source,
            name=name,
            config=settings.config,
            settings=settings.changes,
            ros=ros_2.settings,
            duration_s=timing.duration,
            loop_s=timing.loop,
            progress=progress,
        )
    return {**run.figures, "exit_code": how_it_ended(run.stopped_by, timing.duration, terminal)}


@settings_options("settings", LiveConfig, LIVE_SETTINGS)
def node_fusion(
    rig: Path,
    /,
    *,
    timing: TimingOptions = TimingOptions(),
    outputs: OutputOptions = OutputOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveOptions = LiveOptions(),
    terminal: Shown,
) -> Figures:
    """Turn the 2D poses of all camera nodes into 3D poses, and publish them in ROS 2.

    Args:
        rig: Calibration file of all cameras, the same on every machine.
    """
    with terminal.stages() as progress:
        run = pf.fusion_node(
            rig,
            config=settings.config,
            settings=settings.changes,
            outputs=outputs.chosen,
            ros=ros_2.settings,
            axes=outputs.axes,
            duration_s=timing.duration,
            progress=progress,
        )
    terminal.show(run.summary())
    return {**run.figures, "exit_code": exit_code(run, timing.duration, terminal)}
