"""`posefuse calibrate extrinsics`."""

from __future__ import annotations

from posefuse.cli.options.calibration import (
    CameraRecordings,
    ExtrinsicsOptions,
    FloorOptions,
    MarkerTargetOptions,
    RigOptions,
)
from posefuse.cli.options.shared import Figures, Shown


def calibrate_extrinsics(
    *inputs: CameraRecordings,
    target: MarkerTargetOptions = MarkerTargetOptions(),
    floor: FloorOptions = FloorOptions(),
    options: ExtrinsicsOptions = ExtrinsicsOptions(),
    files: RigOptions,
    terminal: Shown,
) -> Figures:
    """Find the pose of each camera (extrinsics) from a moving marker object or board.

    Args:
        inputs: Video or folder of images per camera; NAME defaults to the file's name.
    """
    from posefuse.cli.calibrating.target_steps import extrinsics

    return extrinsics(inputs, target, floor, options, files, terminal)
