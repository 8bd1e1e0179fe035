"""`posefuse node fusion`: 2D poses of all camera nodes to 3D."""

from __future__ import annotations

from pathlib import Path

from posefuse.cli.options.live import LiveSettingsOptions, OutputOptions, TimingOptions
from posefuse.cli.options.shared import Figures, Ros2Options, Shown


def node_fusion(
    rig: Path,
    /,
    *,
    timing: TimingOptions = TimingOptions(),
    outputs: OutputOptions = OutputOptions(),
    ros_2: Ros2Options = Ros2Options(),
    settings: LiveSettingsOptions = LiveSettingsOptions(),
    terminal: Shown,
) -> Figures:
    """Turn the 2D poses of all camera nodes into 3D poses, and publish them in ROS 2.

    Args:
        rig: Calibration file of all cameras, the same on every machine.
    """
    from posefuse.cli.nodes import fusion_node

    return fusion_node(rig, timing, outputs, ros_2, settings, terminal)
