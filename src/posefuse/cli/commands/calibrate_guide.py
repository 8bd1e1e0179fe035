"""`posefuse calibrate guide`."""

from __future__ import annotations

from posefuse.cli.options.calibration import GuideOptions, MarkerTargetOptions
from posefuse.cli.options.shared import Figures, Ros2Options, Shown


def calibrate_guide(
    *,
    target: MarkerTargetOptions = MarkerTargetOptions(),
    options: GuideOptions,
    ros_2: Ros2Options = Ros2Options(),
    terminal: Shown,
) -> Figures:
    """Show live, while you move the target, how much of each image is covered and what is still missing."""
    from posefuse.cli.calibrating.guiding import guide_at_cameras

    return guide_at_cameras(target, options, ros_2, terminal)
