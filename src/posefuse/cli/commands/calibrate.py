"""`posefuse calibrate`, step by step, and `posefuse record`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Group, Parameter

from posefuse.calibration.settings import TargetDescription
from posefuse.cli.options import (
    EXPERT,
    MOST_S,
    Figures,
    NetworkOptions,
    OptionalFile,
    Options,
    Ros2Options,
    Seconds,
    Shown,
    Sources,
    count,
    positive,
    settings_options,
)

# ten times the fastest camera of a laboratory
_MOST_HZ, _MOST_HEIGHT_M, _MOST_MM = 10_000.0, 3.0, 10_000.0
ClockMode = Literal["auto", "together", "offset", "drift"]
InputKind = Literal["auto", "videos", "images", "pose2d"]
CameraRecordings = Annotated[str, Parameter(metavar="SESSION|NAME=PATH", required=True)]
File = Annotated[Path, Parameter(metavar="FILE")]
Target = Annotated[Path, Parameter(metavar="FILE.toml", help="Target file that `calibrate print` wrote: what the cameras see.")]
RateHz = Annotated[float | None, Parameter(metavar="HZ"), positive(_MOST_HZ)]
Every = Annotated[int, Parameter(metavar="N", help="Look at every Nth frame."), count(1_000_000), EXPERT]
Clocks = Annotated[
    ClockMode,
    Parameter(
        help="Estimate the clock offsets of the cameras: never (together), always (offset; with drift), or when needed (auto)."
    ),
]
MostSeconds = Annotated[
    float,
    Parameter(metavar="S", help="Largest clock offset between two cameras to search for, in seconds."),
    positive(MOST_S),
    EXPERT,
]
UpsideDown = Annotated[
    tuple[str, ...], Parameter(metavar="CAMERA", help="Camera that is mounted upside down. May be given several times.")
]
_TARGET = Group("Target", sort_key=2)
_USUAL_TARGET = {
    "kind": "target", "columns": "columns N", "rows": "rows N", "square_mm": "square-mm MM", "marker_mm": "marker-mm MM",
    "ids": "ids A,B,...",
}  # fmt: skip
_UNUSUAL_TARGET = {
    "thickness_mm": "thickness-mm MM", "dictionary": "dictionary NAME", "inverted": "inverted", "legacy": "legacy",
}  # fmt: skip


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FileOptions:
    """What a step writes.

    Attributes:
        force: Replace files; the old ones are kept as NAME.replaced-TIME.
    """

    force: bool = False


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ReportOptions(FileOptions):
    """What a step writes.

    Attributes:
        report: HTML report; also written when the calibration is refused.
    """

    report: OptionalFile = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RigOptions(ReportOptions):
    """What a step writes.

    Attributes:
        out: Rig file to write.
    """

    out: File


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class IntrinsicsOptions(RigOptions):
    """From what the intrinsics are found."""

    target: Target
    every: Every = 1


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ExtrinsicsOptions(IntrinsicsOptions):
    """How the camera poses are found.

    Attributes:
        intrinsics: Rig file with the intrinsics; without it, they are found from the same recording, if it determines them.
        floor_marker: Marker that lies on the floor in the same recordings; without it, up is estimated from the cameras.
        floor_side_mm: Edge of that marker, where it differs from the target's.
        floor_points: Or: pixels per camera of three points of the floor: origin, one along x, one towards y.
        refine_lenses: Refine the intrinsics too; how well their focal lengths are known, in percent, e.g. 0.5.
        any_size: Accept a rig far smaller or larger than a room.
        keep_refused: Write a refused result too, marked as refused; `posefuse track` then warns each time.
    """

    intrinsics: OptionalFile = None
    floor_marker: Annotated[int | None, Parameter(metavar="ID")] = None
    floor_side_mm: Annotated[float | None, Parameter(metavar="MM"), positive(_MOST_MM)] = None
    floor_points: Annotated[Path | None, Parameter(metavar="FILE.toml")] = None
    clocks: Clocks = "auto"
    refine_lenses: Annotated[float | None, Parameter(metavar="PERCENT"), positive(100), EXPERT] = None
    any_size: Annotated[bool, EXPERT] = False
    keep_refused: Annotated[bool, EXPERT] = False
    upside_down: UpsideDown = ()


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PersonOptions(RigOptions, NetworkOptions):
    """How the camera poses are found from a person.

    Attributes:
        intrinsics: Rig file with the intrinsics.
        height_m: Height of the person in metres, which sets the scale within a few per cent.
        apart: Or: the measured distance of two cameras.
        rate: Frame rate of 2D poses.
    """

    intrinsics: File
    height_m: Annotated[float | None, Parameter(metavar="M"), positive(_MOST_HEIGHT_M)] = None
    apart: Annotated[tuple[str, str, float] | None, Parameter(metavar="CAMERA CAMERA METRES")] = None
    rate: Annotated[RateHz, EXPERT] = None
    clocks: Clocks = "auto"
    most_s: MostSeconds = 10.0
    upside_down: UpsideDown = ()


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ClockOptions(ReportOptions, NetworkOptions):
    """How the clock offsets are found.

    Attributes:
        rig: Calibration file, when it is not in SESSION.
        input: Which data of the session to use.
        clocks: Whether to estimate a drift (a different clock rate) as well.
        rate: Frame rate of 2D poses and images that state none.
        seconds: Use so many seconds from the middle of the recording.
    """

    rig: OptionalFile = None
    input: Annotated[InputKind | None, EXPERT] = None
    clocks: Literal["offset", "drift"] = "offset"
    rate: Annotated[RateHz, EXPERT] = None
    seconds: Annotated[float, Parameter(metavar="S"), positive(MOST_S), EXPERT] = 60.0
    most_s: MostSeconds = 10.0


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class VerifyOptions(ReportOptions):
    """What is verified.

    Attributes:
        rig: Rig file to verify.
        offset_ms: Clock offset in milliseconds, in place of those in posefuse.toml next to the rig file. May be given several
            times.
    """

    rig: File
    target: Target
    every: Every = 1
    offset_ms: Annotated[tuple[str, ...], Parameter(metavar="CAMERA=MS")] = ()


@dataclass(frozen=True, kw_only=True)
class PrintOptions(FileOptions, Options):
    """What is printed.

    Attributes:
        out: PDF to write; its description, which the other steps take as --target, goes next to it.
        cube: Six markers for a cube.
        page: Paper: a4, a3, a2, a1, a0 or letter.
    """

    out: File
    cube: bool = False
    page: Annotated[str, Parameter(metavar="SIZE")] = "a4"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class GuideOptions:
    """The cameras, and where their videos go.

    Attributes:
        intrinsics: Rig file that gives the cameras' names and their order.
        record: Keep the videos in this new folder, as `posefuse record` does: the target need not be moved a second time.
        duration: Stop after so many seconds at the latest.
    """

    target: Target
    source: Annotated[Sources, Parameter(required=True)]
    intrinsics: OptionalFile = None
    record: Annotated[Path | None, Parameter(metavar="SESSION")] = None
    duration: Seconds = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RecordOptions:
    """The cameras, and where their videos go.

    Attributes:
        out: New folder: videos/CAMERA.mp4, and CAMERA.json with what was lost.
        rig: Rig file to put into the session; frames must have its sizes.
        duration: Stop so many seconds after the first frame of the last camera; else at Ctrl-C, or when the sources end.
        resume: Complete the recording of SESSION that was interrupted; no cameras are opened.
    """

    source: Sources = ()
    out: Annotated[Path, Parameter(metavar="SESSION")]
    rig: OptionalFile = None
    duration: Seconds = None
    resume: bool = False


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
