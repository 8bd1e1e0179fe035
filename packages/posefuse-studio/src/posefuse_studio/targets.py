"""Targets to print: files of the workspace, a PDF to scale and the description that calibration reads."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from posefuse.calibration.intrinsics import check_board
from posefuse.calibration.targets.kinds import Charuco, Markers, Target, read_target, write_target
from posefuse.calibration.targets.printing import CUBE_IDS, board_sheets, marker_sheets, write_pdf
from posefuse.core import InputError, PosefuseError
from posefuse.foundation.output_file import atomic_file

from .calibrations import Step
from .workspace import StudioWorkspace

FOLDER = "targets"
# the last of the 50 markers of the dictionary; a board takes the first ones, so that it can lie in view of a cube's recording
_FIRST_CUBE_ID = 50 - CUBE_IDS
FLOOR_ID = _FIRST_CUBE_ID - 1
"""Marker that is printed with a cube and lies on the floor: the world's origin, and what is up."""


@dataclass(frozen=True, kw_only=True)
class Printed:
    """Names in the workspace of a target's description and of its PDF."""

    target: str
    pdf: str


def print_board(workspace: StudioWorkspace, *, columns: int, rows: int, square_mm: float, page: str) -> Printed:
    """A ChArUco board.

    Raises:
        ConfigError: a board that cannot be, or does not fit on the page.
    """
    kind = board_of(columns=columns, rows=rows, square_mm=square_mm)
    return _printed(workspace, f"board {columns}x{rows} {square_mm:g} mm", kind, page)


def board_of(*, columns: int, rows: int, square_mm: float) -> Charuco:
    """The ChArUco board of these squares; raises ConfigError for one that cannot be."""
    return Charuco(columns=columns, rows=rows, square_m=square_mm / 1e3, marker_m=0.75 * square_mm / 1e3)


def print_cube(workspace: StudioWorkspace, *, marker_mm: float, page: str) -> Printed:
    """Six markers for the faces of a cube, and one for the floor; none of them is on a board of up to 43 markers.

    Raises:
        ConfigError: markers that do not fit on the page.
    """
    ids = (FLOOR_ID, *range(_FIRST_CUBE_ID, _FIRST_CUBE_ID + CUBE_IDS))
    return _printed(workspace, f"cube {marker_mm:g} mm", Markers(side_m=marker_mm / 1e3, ids=ids), page)


def without_floor(target: Target) -> Target:
    """What of a target is moved."""
    if isinstance(target, Markers) and FLOOR_ID in target.ids:
        return replace(target, ids=tuple(one for one in target.ids if one != FLOOR_ID))
    return target


def targets(workspace: StudioWorkspace, step: Step) -> list[str]:
    """Descriptions in the workspace that can serve a step of a calibration."""
    folder, found = workspace.path(FOLDER), []
    for path in sorted(folder.glob("*.toml")) if folder.is_dir() else []:
        with suppress(PosefuseError):
            check_target(read_target(path), step)
            found.append(f"{FOLDER}/{path.name}")
    return found


def check_target(target: Target, step: Step) -> None:
    """Whether it can serve the step: a cube for the positions; for the others a board, which the rig was not made from.

    Raises:
        InputError: it is of the other kind. CalibrationError: lenses cannot be calibrated from so small a board.
    """
    if isinstance(target, Markers) != (step == "extrinsics"):
        raise InputError("target: expected a cube of markers for the positions, and a board for the lenses and the verification")
    if step == "intrinsics":
        check_board(target)


def _printed(workspace: StudioWorkspace, stem: str, kind: Charuco | Markers, page: str) -> Printed:
    sheets = board_sheets(kind, page) if isinstance(kind, Charuco) else marker_sheets(kind, kind.ids, page)
    described = f"{FOLDER}/{stem}.toml"
    pdf = workspace.folder(FOLDER) / Path(f"{stem}.pdf")
    with atomic_file(pdf) as temporary:
        write_pdf(temporary, sheets)
    write_target(workspace.path(described), kind)
    return Printed(target=described, pdf=f"{FOLDER}/{stem}.pdf")
