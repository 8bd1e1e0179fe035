"""`posefuse calibrate intrinsics`."""

from __future__ import annotations

from posefuse.cli.options.calibration import CameraRecordings, FrameOptions, RigOptions, TargetOptions
from posefuse.cli.options.shared import Figures, Shown


def calibrate_intrinsics(
    *inputs: CameraRecordings,
    target: TargetOptions = TargetOptions(),
    frames: FrameOptions = FrameOptions(),
    files: RigOptions,
    terminal: Shown,
) -> Figures:
    """Find the intrinsics of each camera from images of a board.

    Args:
        inputs: Video or folder of images per camera; NAME defaults to the file's name.
    """
    from posefuse.cli.calibrating.target_steps import intrinsics

    return intrinsics(inputs, target, frames, files, terminal)
