"""Targets to print: files of the workspace, a PDF to scale and the description that calibration reads."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from posefuse.calibration.targets.description import write_target
from posefuse.calibration.targets.kinds import Charuco, Markers, Target
from posefuse.calibration.targets.printing import CUBE_IDS, board_sheets, cube_sheets, write_pdf
from posefuse.foundation.atomic import atomic_file

from .workspace import StudioWorkspace

FOLDER = "targets"
# the last of the 50 markers of the dictionary; a board takes the first ones, so that it can lie in view of a cube's recording
_FIRST_CUBE_ID = 50 - CUBE_IDS


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
    kind = Charuco(columns=columns, rows=rows, square_m=square_mm / 1e3, marker_m=0.75 * square_mm / 1e3)
    return _printed(workspace, f"board {columns}x{rows} {square_mm:g} mm", kind, page)


def print_cube(workspace: StudioWorkspace, *, marker_mm: float, page: str) -> Printed:
    """Six markers for the faces of a cube; none of them is on a board of up to 44 markers.

    Raises:
        ConfigError: markers that do not fit on the page.
    """
    ids = tuple(range(_FIRST_CUBE_ID, _FIRST_CUBE_ID + CUBE_IDS))
    return _printed(workspace, f"cube {marker_mm:g} mm", Markers(side_m=marker_mm / 1e3, ids=ids), page)


def targets(workspace: StudioWorkspace) -> list[str]:
    """Descriptions in the workspace."""
    folder = workspace.path(FOLDER)
    return [f"{FOLDER}/{path.name}" for path in sorted(folder.glob("*.toml"))] if folder.is_dir() else []


def _printed(workspace: StudioWorkspace, stem: str, kind: Target, page: str) -> Printed:
    sheets = board_sheets(kind, page) if isinstance(kind, Charuco) else cube_sheets(kind, _FIRST_CUBE_ID, page)  # type: ignore[arg-type]
    described = f"{FOLDER}/{stem}.toml"
    pdf = workspace.folder(FOLDER) / Path(f"{stem}.pdf")
    with atomic_file(pdf) as temporary:
        write_pdf(temporary, sheets)
    write_target(workspace.path(described), kind)
    return Printed(target=described, pdf=f"{FOLDER}/{stem}.pdf")
