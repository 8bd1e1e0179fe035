"""`posefuse calibrate verify`."""

from __future__ import annotations

from posefuse.cli.options.calibration import CameraRecordings, ReportOptions, TargetOptions, VerifyOptions
from posefuse.cli.options.shared import Figures, Shown


def calibrate_verify(
    *inputs: CameraRecordings,
    target: TargetOptions = TargetOptions(),
    options: VerifyOptions,
    files: ReportOptions = ReportOptions(),
    terminal: Shown,
) -> Figures:
    """Measure the errors of a rig, in millimetres and pixels, with a marker or board held anywhere.

    Args:
        inputs: Video or folder of images per camera; NAME defaults to the file's name.
    """
    from posefuse.cli.calibrating.target_steps import verify_rig

    return verify_rig(inputs, target, options, files, terminal)
