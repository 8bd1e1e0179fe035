"""`posefuse record` and `posefuse calibrate`, step by step."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

import posefuse as pf
from posefuse.calibration.settings import TargetDescription
from posefuse.core import InputError
from posefuse.pipeline.config import CONFIG_FILE

from .options import (
    MOST_S,
    Figures,
    NamedSettings,
    NetworkOptions,
    OptionalFile,
    Ros2Options,
    Seconds,
    Shown,
    Sources,
    arguments_of,
    count,
    positive,
    settings_options,
)
from .stopping import session_exit_code
from .terminal import Terminal, option_of, quoted

if TYPE_CHECKING:
    from posefuse.api.calibration_results import IntrinsicsCalibration
    from posefuse.calibration.targets.coverage import Guidance

CameraRecordings = Annotated[str, Parameter(metavar="SESSION|NAME=PATH", required=True)]
_TARGET = Group("Target", sort_key=2)
_TARGET_SETTINGS = {
    "columns": "columns N", "rows": "rows N", "square_mm": "square-mm MM", "marker_mm": "marker-mm MM",
    "ids": "ids A,B,...", "dictionary": "dictionary NAME", "inverted": "inverted", "legacy": "legacy",
}  # fmt: skip
# ten times the fastest camera of a laboratory
_MOST_HZ, _MOST_HEIGHT_M = 10_000.0, 3.0
# options of `calibrate clocks` without which `track` does not read the same session
_ALSO_OF_TRACK = ("rig", "input", "rate_hz", "networks", "device")
ClockMode = Literal["auto", "together", "offset", "drift"]
InputKind = Literal["auto", "videos", "images", "pose2d"]
File = Annotated[Path, Parameter(metavar="FILE")]
Target = Annotated[Path, Parameter(metavar="FILE.toml", help="Target file that `calibrate print` wrote: what the cameras see.")]
RateHz = Annotated[float | None, Parameter(metavar="HZ"), positive(_MOST_HZ)]
Every = Annotated[int, Parameter(metavar="N", help="Look at every Nth frame."), count(1_000_000)]
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
]
UpsideDown = Annotated[
    tuple[str, ...], Parameter(metavar="CAMERA", help="Camera that is mounted upside down. May be given several times.")
]


@Parameter(name="*", name_transform=option_of)
@dataclass(frozen=True, kw_only=True)
class FileOptions:
    """What a step writes.

    Attributes:
        replace: Replace files; the old ones are kept as NAME.replaced-TIME.
    """

    replace: bool = False


@dataclass(frozen=True, kw_only=True)
class ReportOptions(FileOptions):
    """What a step writes.

    Attributes:
        report: HTML report; also written when the calibration is refused.
    """

    report: OptionalFile = None


@dataclass(frozen=True, kw_only=True)
class RigOptions(ReportOptions):
    """What a step writes.

    Attributes:
        out: Rig file to write.
    """

    out: File


@dataclass(frozen=True, kw_only=True)
class IntrinsicsOptions(RigOptions):
    """From what the intrinsics are found."""

    target: Target
    every: Every = 1


@dataclass(frozen=True, kw_only=True)
class ExtrinsicsOptions(IntrinsicsOptions):
    """How the camera poses are found.

    Attributes:
        intrinsics: Rig file with the intrinsics; without it, they are found from the same recording, if it determines them.
        floor_marker: Marker that lies on the floor in the same recordings; without it, up is estimated from the cameras.
        focal_known_to_percent: Refine the intrinsics too; how well their focal lengths are known, in percent, e.g. 0.5.
        any_size: Accept a rig far smaller or larger than a room.
        keep_refused: Write a refused result too, marked as refused; `posefuse track` then warns each time.
    """

    intrinsics: OptionalFile = None
    floor_marker: Annotated[int | None, Parameter(metavar="ID")] = None
    clocks: Clocks = "auto"
    focal_known_to_percent: Annotated[float | None, Parameter(metavar="PERCENT"), positive(100)] = None
    any_size: bool = False
    keep_refused: bool = False
    upside_down: UpsideDown = ()


@dataclass(frozen=True, kw_only=True)
class PersonOptions(RigOptions, NetworkOptions):
    """How the camera poses are found from a person.

    Attributes:
        intrinsics: Rig file with the intrinsics.
        height_m: Height of the person in metres, which sets the scale within a few per cent.
        camera_distance: Or: the measured distance of two cameras.
        rate_hz: Frame rate of 2D poses.
    """

    intrinsics: File
    height_m: Annotated[float | None, Parameter(metavar="M"), positive(_MOST_HEIGHT_M)] = None
    camera_distance: Annotated[tuple[str, str, float] | None, Parameter(metavar="CAMERA CAMERA METRES")] = None
    rate_hz: RateHz = None
    clocks: Clocks = "auto"
    max_offset_s: MostSeconds = 10.0
    upside_down: UpsideDown = ()


@dataclass(frozen=True, kw_only=True)
class ClockOptions(ReportOptions, NetworkOptions):
    """How the clock offsets are found.

    Attributes:
        rig: Calibration file, when it is not in SESSION.
        input: Which data of the session to use.
        clocks: Whether to estimate a drift (a different clock rate) as well.
        rate_hz: Frame rate of 2D poses and images that state none.
        seconds: Use so many seconds from the middle of the recording.
    """

    rig: OptionalFile = None
    input: InputKind | None = field(default=None, metadata={"key": "input"})
    clocks: Literal["offset", "drift"] = "offset"
    rate_hz: RateHz = None
    seconds: Annotated[float, Parameter(metavar="S"), positive(MOST_S)] = 60.0
    max_offset_s: MostSeconds = 10.0


@dataclass(frozen=True, kw_only=True)
class VerifyOptions(ReportOptions):
    """What is verified.

    Attributes:
        rig: Rig file to verify; clock offsets are those of the posefuse.toml next to it.
    """

    rig: File
    target: Target
    every: Every = 1


@dataclass(frozen=True, kw_only=True)
class PrintOptions(FileOptions, NamedSettings):
    """What is printed.

    Attributes:
        out: PDF to write; its description, which the other steps take as --target, goes next to it.
        target: A ChArUco board, or loose markers.
        cube: Six markers for a cube.
        page: Paper: a4, a3, a2, a1, a0 or letter.
    """

    out: File
    target: Literal["charuco", "markers"] = field(default="charuco", metadata={"key": "kind"})
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


def record(*, options: RecordOptions, ros_2: Ros2Options = Ros2Options(), terminal: Shown) -> Figures:
    """Record cameras: one video per camera on one clock, for calibration or tracking.

    Frames keep their own times and, where a camera encodes, its own packets. Rates, drops and exposure are watched.
    """
    if options.resume:
        done = pf.resume_recording(options.out)
        terminal.show(done.summary())
        return {**done.figures, "exit_code": 0}
    with terminal.stages() as progress:
        done = pf.record(
            options.source, options.out, rig=options.rig, duration_s=options.duration, ros=ros_2.settings, progress=progress
        )
    terminal.show(done.summary())
    if options.rig is None:
        command = f"posefuse calibrate intrinsics --target TARGET.toml --out lenses.toml {quoted(options.out)}"
        terminal.next(command, "the intrinsics, from a board; or `calibrate extrinsics` with --intrinsics, from a moved target")
    else:
        terminal.next(f"posefuse track {quoted(options.out)} --out RESULT", "the 3D skeleton")
    code = session_exit_code(done.stopped_by, endless=options.duration is None, failed=done.lost)
    return {**done.figures, "exit_code": code}


def calibrate_guide(*, options: GuideOptions, ros_2: Ros2Options = Ros2Options(), terminal: Shown) -> Figures:
    """Show live, while you move the target, how much of each image is covered and what is still missing."""
    from posefuse.foundation.summary import Heading, Table

    def show(state: "Guidance") -> None:
        covered = state.coverage
        rows = [(name, f"{share:.0%}", *counts) for name, share, counts in
                zip(covered.cameras, covered.share, covered.together.tolist(), strict=True)]  # fmt: skip
        terminal.show([Heading("seen together with"), Table(("camera", "covered", *covered.cameras), rows)])
        terminal.note(covered.advice())

    found = pf.record(
        options.source,
        options.record,
        rig=options.intrinsics,
        target=options.target,
        duration_s=options.duration,
        ros=ros_2.settings,
        on_coverage=show,
    )
    terminal.show(found.summary())
    if not found.figures["enough"]:
        terminal.note(f"not enough yet: {found.figures['next']}")
    lenses = "" if options.intrinsics is None else f" --intrinsics {quoted(options.intrinsics)}"
    where = quoted(options.record or "SESSION")
    command = f"posefuse calibrate extrinsics {where} --target {quoted(options.target)}{lenses} --out rig.toml"
    terminal.next(command, "the rig from what was recorded")
    code = session_exit_code(found.stopped_by, endless=options.duration is None, failed=found.lost)
    return {**found.figures, "exit_code": code}


def check_files(options: Any, inputs: Sequence[str] = ()) -> None:
    """Raise InputError before any work where a file that the step will write cannot be, or exists without --force.

    Args:
        options: of the step. inputs: ``NAME=PATH`` texts of recordings.
    """
    from posefuse.calibration.targets.recordings import paths_by_camera
    from posefuse.foundation.output_file import check_output_file

    named = [getattr(options, name, None) for name in ("target", "intrinsics", "rig")]
    read = [*paths_by_camera(inputs).values(), *(path for path in named if path is not None)]
    for name in ("out", "report"):
        if (path := getattr(options, name, None)) is not None:
            check_output_file(path, option=f"--{option_of(name)}", inputs=read, replace=options.replace)
            if name == "out" and path.suffix != ".toml":
                raise InputError(f"--out {path}: a rig file is TOML: expected a name that ends in .toml")


@contextmanager
def reported(path: Path | None) -> Iterator[None]:
    """Write the report of a refused calibration before the error is raised further."""
    from posefuse.calibration.report import RefusedCalibration

    try:
        yield
    except RefusedCalibration as refused:
        if path is not None:
            refused.report.save(path)
        raise


def calibrate_intrinsics(*inputs: CameraRecordings, options: IntrinsicsOptions, terminal: Shown) -> Figures:
    """Find the intrinsics of each camera from images of a board.

    Args:
        inputs: Video or folder of images per camera; NAME defaults to the file's name.
    """
    from posefuse.calibration.report import RefusedCalibration

    check_files(options, inputs)
    with reported(options.report):
        try:
            with terminal.stages() as progress:
                found = pf.calibrate_intrinsics(inputs, **arguments_of(pf.calibrate_intrinsics, options), progress=progress)
        except RefusedCalibration as refused:
            if refused.kept is not None:
                _save_intrinsics(refused.kept, options, terminal)
            raise
    _save_intrinsics(found, options, terminal)
    lenses = f"--intrinsics {quoted(options.out)}"
    terminal.next(
        f"posefuse calibrate guide --target CUBE.toml {lenses} --source CAMERA=KIND:WHERE ... --record SESSION",
        "move a target where two cameras see it; `calibrate extrinsics` then finds the poses of the cameras",
    )
    return {"rig": str(options.out), "cameras": {name: dict(report.numbers) for name, report in found.reports.items()}}


def _save_intrinsics(found: "IntrinsicsCalibration", options: IntrinsicsOptions, terminal: Terminal) -> None:
    """Reports and rig file; cameras of an older file that were not calibrated now stay in it."""
    for report in found.reports.values():
        terminal.show(report.summary())
    found.save(options.out, report=options.report, replace=options.replace)
    stay = [camera.name for camera in pf.read_rig(options.out) if camera.name not in found.reports]
    terminal.note(f"{options.out}: intrinsics of {', '.join(found.reports)}" + (f"; {', '.join(stay)} as before" if stay else ""))


def calibrate_extrinsics(*inputs: CameraRecordings, options: ExtrinsicsOptions, terminal: Shown) -> Figures:
    """Find the pose of each camera (extrinsics) from a moving marker object or board.

    Args:
        inputs: Video or folder of images per camera; NAME defaults to the file's name.
    """
    check_files(options, inputs)
    with reported(options.report), terminal.stages() as progress:
        found = pf.calibrate_extrinsics(inputs, **arguments_of(pf.calibrate_extrinsics, options), progress=progress)
    if found.report.failed:
        failed = ", ".join(check.name for check in found.report.failed)
        terminal.warn(f"refused ({failed}); kept all the same (--keep-refused), and marked as refused in the file")
    terminal.show(found.report.summary())
    found.save(options.out, report=options.report, replace=options.replace)
    settings = _save_clocks(options.out.parent, found, terminal)
    terminal.next(
        f"posefuse calibrate verify SESSION --target BOARD.toml --rig {quoted(options.out)}",
        "with a target that the rig was not made from",
    )
    return {
        "rig": str(options.out),
        "settings": settings,
        **found.report.numbers,
        "notes": list(found.report.notes),
    }


def _save_clocks(folder: Path, found: Any, terminal: Terminal) -> str | None:
    """The settings file with the clock offsets that were found; None where there is nothing to correct, or one is there."""
    from posefuse.api.calibration_results import save_clocks

    path = save_clocks(folder / CONFIG_FILE, found.rig.names, found.clocks)
    if path is None:
        return None
    terminal.note(f"{path}: clock offsets of the cameras, for `posefuse track` of recordings made together with these")
    return str(path)


def calibrate_person(*inputs: CameraRecordings, options: PersonOptions, terminal: Shown) -> Figures:
    """Find the pose of each camera (extrinsics) from a person who walks in front of the cameras.

    Args:
        inputs: Video, or 2D poses of another tool, per camera; NAME defaults to the file's name.
    """
    check_files(options, inputs)
    with reported(options.report), terminal.stages() as progress:
        found = pf.calibrate_person(inputs, **arguments_of(pf.calibrate_person, options), progress=progress)
    terminal.show(found.summary())
    found.save(options.out, report=options.report, replace=options.replace)
    settings = _save_clocks(options.out.parent, found, terminal)
    files = f"{options.out} and {settings}" if settings else options.out
    terminal.next(f"put {files} into the folder of your videos: posefuse track SESSION --out RESULT", "the 3D skeleton")
    return {"rig": str(options.out), "settings": settings, **found.numbers}


def calibrate_clocks(session: Path, /, *, options: ClockOptions = ClockOptions(), terminal: Shown) -> Figures:
    """Find the clock offsets of calibrated cameras that are not synchronised, from a person who moves.

    Args:
        session: As for `posefuse track`: a folder with the calibration file and the recordings.
    """
    check_files(options)
    with reported(options.report), terminal.stages() as progress:
        given = arguments_of(pf.calibrate_clocks, options)
        found = pf.calibrate_clocks(session, **given, drift=options.clocks == "drift", progress=progress)
    terminal.show(found.summary())
    if options.report is not None:
        found.save_report(options.report, replace=options.replace)
    settings = _save_clocks(session, found, terminal)
    needed = f"add the offsets to {session / CONFIG_FILE} first" if found.clock_settings else "the clocks need no correction"
    terminal.next(
        f"posefuse track {quoted(session)} {_also_of_track(options)}--out RESULT", "uses the clocks found" if settings else needed
    )
    return {"settings": settings, **found.report.numbers}


def _also_of_track(options: ClockOptions) -> str:
    """Options as they are typed, and a space: those with which the session was read."""
    words = ""
    for option in fields(options):
        value = getattr(options, option.name)
        if option.name in _ALSO_OF_TRACK and value != option.default:
            words += f"--{option_of(option.name)} {quoted(value)} "
    return words


def calibrate_verify(*inputs: CameraRecordings, options: VerifyOptions, terminal: Shown) -> Figures:
    """Measure the errors of a rig, in millimetres and pixels, with a marker or board held anywhere.

    Args:
        inputs: Video or folder of images per camera; NAME defaults to the file's name.
    """
    check_files(options, inputs)
    with terminal.stages() as progress:
        found = pf.verify(inputs=inputs, **arguments_of(pf.verify, options), progress=progress)
    terminal.show(found.report.summary())
    if options.report is not None:
        found.save(options.report, replace=options.replace)
    found.report.require()
    terminal.next(f"put {options.rig} into the folder of your videos: posefuse track SESSION --out RESULT", "the rig is good")
    return dict(found.report.numbers)


@settings_options("options", TargetDescription, _TARGET_SETTINGS, _TARGET)
def calibrate_print(*, options: PrintOptions, terminal: Shown) -> Figures:
    """Make a PDF of a target at its true size."""
    made = pf.print_target(**arguments_of(pf.print_target, options))
    terminal.note(f"{made.pdf}: {made.pages} page{'s' * (made.pages > 1)}; print at 100 % and measure the ruler")
    terminal.note(f"{made.target}: the target's description, which the other steps take as --target {quoted(made.target)}")
    command = "posefuse record --source cam1=usb:/dev/video0 ... --out SESSION"
    terminal.next(command, f"videos of it for `posefuse calibrate {made.step}`")
    return {"pdf": str(made.pdf), "pages": made.pages, "target": str(made.target)}
