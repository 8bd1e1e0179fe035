"""Options of the steps of `posefuse calibrate`, in the groups that the functions below take."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from .options import TARGET, count, positive

# the largest values that can be meant: a target of 10 m, a day, ten times the fastest camera of a laboratory
MOST_MM, MOST_S, MOST_HZ, MOST_HEIGHT_M = 10_000.0, 86_400.0, 10_000.0, 3.0
# squares of a board along one side, and frames between two that are looked at
MOST_SQUARES, MOST_FRAMES = 200, 1_000_000
ClockMode = Literal["auto", "together", "offset", "drift"]
TargetName = Literal["markers", "charuco", "chessboard", "aruco-board"]
CLOCKS_HELP = "Estimate the clock offsets of the cameras: never (together), always (offset; with drift), or when needed (auto)."
MOST_S_HELP = "Largest clock offset between two cameras to search for, in seconds."

CameraRecordings = Annotated[str, Parameter(metavar="NAME=PATH", required=True)]
RigFile = Annotated[Path, Parameter(metavar="FILE")]
OptionalFile = Annotated[Path | None, Parameter(metavar="FILE")]
Millimetres = Annotated[float | None, Parameter(metavar="MM"), positive(MOST_MM)]
Squares = Annotated[int | None, Parameter(metavar="N"), count(MOST_SQUARES)]
Every = Annotated[int, Parameter(metavar="N", help="Look at every Nth frame."), count(MOST_FRAMES)]
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
    """What the cameras see."""
    columns: Squares = None
    """Squares across (charuco), inner corners (chessboard), markers (aruco-board)."""
    rows: Squares = None
    """The same, down."""
    square_mm: Millimetres = None
    """Edge of a square."""
    marker_mm: Millimetres = None
    """Edge of a marker's black square."""
    gap_mm: Millimetres = None
    """White gap between two markers (aruco-board)."""
    dictionary: Annotated[str, Parameter(metavar="NAME")] = "DICT_4X4_50"
    """OpenCV's name of the marker dictionary."""
    ids: Annotated[tuple[int, ...], Parameter(metavar="ID", consume_multiple=True)] = ()
    """Markers of the target (default all); of an aruco-board the first."""
    inverted: bool = False
    """Black and white are exchanged."""
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
