"""`posefuse calibrate verify`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

from .calibrate_options import CameraRecordings, Every, ReportOptions, RigFile, TargetOptions
from .options import Figures, Shown


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class VerifyOptions:
    """What is verified."""

    rig: RigFile
    """Rig file to verify."""
    every: Every = 1
    offset_ms: Annotated[tuple[str, ...], Parameter(metavar="CAMERA=MS")] = ()
    """Clock offset found by `extrinsics`, in milliseconds. May be given several times."""


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
