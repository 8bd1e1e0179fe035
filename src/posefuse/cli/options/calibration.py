"""Options of the steps of `posefuse calibrate`, in the groups that the functions below take."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from .shared import FLOOR, TARGET, InputKind, count, positive

# the largest values that can be meant: a target of 10 m, a day, ten times the fastest camera of a laboratory
MOST_MM, MOST_S, MOST_HZ, MOST_HEIGHT_M = 10_000.0, 86_400.0, 10_000.0, 3.0
# squares of a board along one side, and frames between two that are looked at
MOST_SQUARES, MOST_FRAMES = 200, 1_000_000
ClockMode = Literal["auto", "together", "offset", "drift"]
TARGETS = ("markers", "charuco", "chessboard")
TARGET_SUFFIX = ".toml"
CLOCKS_HELP = "Estimate the clock offsets of the cameras: never (together), always (offset; with drift), or when needed (auto)."
MOST_S_HELP = "Largest clock offset between two cameras to search for, in seconds."


def _check_target(_: object, value: str) -> None:
    if value not in TARGETS and not value.endswith(TARGET_SUFFIX):
        raise ValueError(f"expected {', '.join(TARGETS)}, or a target file (.toml) of `posefuse calibrate print`, got {value!r}")


CameraRecordings = Annotated[str, Parameter(metavar="SESSION|NAME=PATH", required=True)]
TargetName = Annotated[
    str,
    Parameter(
        metavar="KIND|FILE.toml",
        help=f"What the cameras see: {', '.join(TARGETS)}; or the target file that `print` wrote, and no sizes.",
        validator=_check_target,
    ),
]
RigFile = Annotated[Path, Parameter(metavar="FILE")]
OptionalFile = Annotated[Path | None, Parameter(metavar="FILE")]
Millimetres = Annotated[float | None, Parameter(metavar="MM"), positive(MOST_MM)]
Squares = Annotated[int | None, Parameter(metavar="N"), count(MOST_SQUARES)]
Clocks = Annotated[ClockMode, Parameter(help=CLOCKS_HELP)]
MostSeconds = Annotated[float, Parameter(metavar="S", help=MOST_S_HELP), positive(MOST_S)]
RateHz = Annotated[float | None, Parameter(metavar="HZ"), positive(MOST_HZ)]
UpsideDown = Annotated[
    tuple[str, ...], Parameter(metavar="CAMERA", help="Camera that is mounted upside down. May be given several times.")
]


@Parameter(name="*", group=TARGET)
@dataclass(frozen=True, kw_only=True)
class TargetOptions:
    """The board or the markers that the cameras see."""

    target: TargetName = "charuco"
    columns: Squares = None
    """Squares across (charuco), inner corners (chessboard)."""
    rows: Squares = None
    """The same, down."""
    square_mm: Millimetres = None
    """Edge of a square."""
    marker_mm: Millimetres = None
    """Edge of a marker's black square."""
    thickness_mm: Millimetres = None
    """Board printed on both sides, tops together: distance of the two prints."""
    dictionary: Annotated[str | None, Parameter(metavar="NAME")] = None
    """OpenCV's name of the marker dictionary (default DICT_4X4_50)."""
    ids: Annotated[tuple[int, ...], Parameter(metavar="ID", consume_multiple=True)] = ()
    """Markers of the target (default all)."""
    inverted: bool = False
    """Black and white are swapped."""
    legacy: bool = False
    """ChArUco layout of OpenCV before 4.6."""


@Parameter(name="*", group=TARGET)
@dataclass(frozen=True, kw_only=True)
class MarkerTargetOptions(TargetOptions):
    """The same, where markers are usual."""

    target: TargetName = "markers"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ReplaceOptions:
    """Files that exist."""

    force: bool = False
    """Replace files; the old ones are kept as NAME.replaced-TIME."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ReportOptions(ReplaceOptions):
    """Files that exist, and the report."""

    report: OptionalFile = None
    """HTML report; also written when the calibration is refused."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RigOptions(ReportOptions):
    """The rig file that a step writes."""

    out: RigFile
    """Rig file to write."""


@Parameter(name="*", group=FLOOR)
@dataclass(frozen=True, kw_only=True)
class FloorOptions:
    """What sets the world coordinates; without it, up is estimated from the cameras."""

    floor_marker: Annotated[int | None, Parameter(metavar="ID")] = None
    """Marker that lies on the floor in the same recordings."""
    floor_side_mm: Millimetres = None
    """Edge of that marker, where it differs from --marker-mm."""
    floor_points: Annotated[Path | None, Parameter(metavar="FILE.toml")] = None
    """Or: pixels per camera of three points of the floor: origin, one along x, one towards y."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FrameOptions:
    """What is looked at."""

    every: Annotated[int, Parameter(metavar="N"), count(MOST_FRAMES)] = 1
    """Look at every Nth frame."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ExtrinsicsOptions(FrameOptions):
    """How the camera poses are found."""

    intrinsics: OptionalFile = None
    """Rig file with the intrinsics; without it, they are found from the same recording, if it determines them."""
    clocks: Clocks = "auto"
    refine_lenses: Annotated[float | None, Parameter(metavar="PERCENT"), positive(100)] = None
    """Refine the intrinsics too; how well their focal lengths are known, in percent, e.g. 0.5."""
    any_size: bool = False
    """Accept a rig far smaller or larger than a room."""
    keep_refused: bool = False
    """Write a refused result too, marked as refused; `posefuse track` then warns each time."""
    upside_down: UpsideDown = ()


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class GuideOptions:
    """The cameras, and where their videos go."""

    intrinsics: OptionalFile = None
    """Rig file that gives the cameras' names and their order."""
    record: Annotated[Path | None, Parameter(metavar="SESSION")] = None
    """Keep the videos in this new folder, as `posefuse record` does: the target need not be moved a second time."""
    source: Annotated[tuple[str, ...], Parameter(metavar="CAMERA=KIND:WHERE", required=True)]
    """One per camera, as in `posefuse live`."""
    duration: Annotated[float | None, Parameter(metavar="S"), positive(MOST_S)] = None
    """Stop after so many seconds at the latest."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PersonOptions:
    """How the camera poses are found from a person."""

    intrinsics: RigFile
    """Rig file with the intrinsics."""
    height_m: Annotated[float | None, Parameter(metavar="M"), positive(MOST_HEIGHT_M)] = None
    """Height of the person in metres, which sets the scale within a few per cent."""
    apart: Annotated[tuple[str, str, float] | None, Parameter(metavar="CAMERA CAMERA METRES")] = None
    """Or: the measured distance of two cameras."""
    rate: RateHz = None
    """Frame rate of 2D poses."""
    clocks: Clocks = "auto"
    most_s: MostSeconds = 10.0
    upside_down: UpsideDown = ()


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ClockOptions:
    """How the clock offsets are found."""

    rig: OptionalFile = None
    """Calibration file, when it is not in SESSION."""
    input: InputKind | None = None
    """Which data of the session to use."""
    clocks: Literal["offset", "drift"] = "offset"
    """Whether to estimate a drift (a different clock rate) as well."""
    rate: RateHz = None
    """Frame rate of 2D poses and images that state none."""
    seconds: Annotated[float, Parameter(metavar="S"), positive(MOST_S)] = 60.0
    """Use so many seconds from the middle of the recording."""
    most_s: MostSeconds = 10.0


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class VerifyOptions(FrameOptions):
    """What is verified."""

    rig: RigFile
    """Rig file to verify."""
    offset_ms: Annotated[tuple[str, ...], Parameter(metavar="CAMERA=MS")] = ()
    """Clock offset in milliseconds, in place of those in posefuse.toml next to the rig file. May be given several times."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PrintOptions(ReplaceOptions):
    """What is printed."""

    out: Annotated[Path, Parameter(metavar="FILE")]
    """PDF to write."""
    cube: bool = False
    """Six markers for a cube."""
    page: Annotated[str, Parameter(metavar="SIZE")] = "a4"
    """Paper: a4, a3, a2, a1, a0 or letter."""
