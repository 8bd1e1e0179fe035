"""`posefuse node camera`: capture and detection on this machine, 2D poses to the fusion node."""

from __future__ import annotations

from pathlib import Path

from posefuse.cli.options.live import LiveSettingsOptions, SourceOptions, TimingOptions
from posefuse.cli.options.shared import Figures, Ros2Options, Shown


def node_camera(
    rig: Path,
    /,
    *,
    sources: SourceOptions = SourceOptions(),
    timing: TimingOptions = TimingOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveSettingsOptions = LiveSettingsOptions(),
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
