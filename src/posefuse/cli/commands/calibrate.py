"""`posefuse calibrate`, step by step, and `posefuse record`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Group, Parameter

from posefuse.calibration.settings import TargetDescription
from posefuse.cli.command_options import (
    ClockOptions,
    ExtrinsicsOptions,
    GuideOptions,
    IntrinsicsOptions,
    PersonOptions,
    PrintOptions,
    RecordOptions,
    VerifyOptions,
)
from posefuse.cli.options import EXPERT, Figures, Ros2Options, Shown, settings_options

CameraRecordings = Annotated[str, Parameter(metavar="SESSION|NAME=PATH", required=True)]
_TARGET = Group("Target", sort_key=2)
_USUAL_TARGET = {
    "kind": "target", "columns": "columns N", "rows": "rows N", "square_mm": "square-mm MM", "marker_mm": "marker-mm MM",
    "ids": "ids A,B,...",
}  # fmt: skip
_UNUSUAL_TARGET = {
    "thickness_mm": "thickness-mm MM", "dictionary": "dictionary NAME", "inverted": "inverted", "legacy": "legacy",
}  # fmt: skip


def record(*, options: RecordOptions, ros_2: Annotated[Ros2Options, EXPERT] = Ros2Options(), terminal: Shown) -> Figures:
    """Record cameras: one video per camera on one clock, for calibration or tracking.

    Frames keep their own times and, where a camera encodes, its own packets. Rates, drops and exposure are watched.
    """
    from posefuse.cli.recording import record_session

    return record_session(options, ros_2, terminal)


def calibrate_intrinsics(*inputs: CameraRecordings, options: IntrinsicsOptions, terminal: Shown) -> Figures:
    """Find the intrinsics of each camera from images of a board.

    Args:
        inputs: Video or folder of images per camera; NAME defaults to the file's name.
    """
    from posefuse.cli.calibrating.target_steps import intrinsics

    return intrinsics(inputs, options, terminal)


def calibrate_extrinsics(*inputs: CameraRecordings, options: ExtrinsicsOptions, terminal: Shown) -> Figures:
    """Find the pose of each camera (extrinsics) from a moving marker object or board.

    Args:
        inputs: Video or folder of images per camera; NAME defaults to the file's name.
    """
    from posefuse.cli.calibrating.target_steps import extrinsics

    return extrinsics(inputs, options, terminal)


def calibrate_guide(*, options: GuideOptions, ros_2: Annotated[Ros2Options, EXPERT] = Ros2Options(), terminal: Shown) -> Figures:
    """Show live, while you move the target, how much of each image is covered and what is still missing."""
    from posefuse.cli.calibrating.guiding import guide_at_cameras

    return guide_at_cameras(options, ros_2, terminal)


def calibrate_person(*inputs: CameraRecordings, options: PersonOptions, terminal: Shown) -> Figures:
    """Find the pose of each camera (extrinsics) from a person who walks in front of the cameras.

    Args:
        inputs: Video, or 2D poses of another tool, per camera; NAME defaults to the file's name.
    """
    from posefuse.cli.calibrating.person_steps import person

    return person(inputs, options, terminal)


def calibrate_clocks(session: Path, /, *, options: ClockOptions = ClockOptions(), terminal: Shown) -> Figures:
    """Find the clock offsets of calibrated cameras that are not synchronised, from a person who moves.

    Args:
        session: As for `posefuse track`: a folder with the calibration file and the recordings.
    """
    from posefuse.cli.calibrating.person_steps import clocks

    return clocks(session, options, terminal)


def calibrate_verify(*inputs: CameraRecordings, options: VerifyOptions, terminal: Shown) -> Figures:
    """Measure the errors of a rig, in millimetres and pixels, with a marker or board held anywhere.

    Args:
        inputs: Video or folder of images per camera; NAME defaults to the file's name.
    """
    from posefuse.cli.calibrating.target_steps import verify_rig

    return verify_rig(inputs, options, terminal)


@settings_options("options", TargetDescription, _UNUSUAL_TARGET, _TARGET, show=False)
@settings_options("options", TargetDescription, _USUAL_TARGET, _TARGET)
def calibrate_print(*, options: PrintOptions, terminal: Shown) -> Figures:
    """Make a PDF of a target at its true size."""
    from posefuse.cli.calibrating.target_steps import print_target

    return print_target(options, terminal)
