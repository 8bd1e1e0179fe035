"""Targets of the workspace: which can serve a step of a calibration, and the two that are printed for all of them."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import posefuse as pf
from posefuse.calibration.intrinsics import check_board
from posefuse.calibration.targets.kinds import Charuco, Markers, Target, read_target
from posefuse.core import InputError, PosefuseError

from .calibrations import Step
from .workspace import StudioWorkspace

FOLDER = "targets"
FLOOR_ID = 43
"""Marker that is printed with a cube and lies on the floor: the world's origin, and what is up."""
# the last of the 50 markers of the dictionary; a board takes the first ones, so that it can lie in view of a cube's recording
_CUBE_IDS = (FLOOR_ID, *range(FLOOR_ID + 1, 50))


def print_targets(workspace: StudioWorkspace, settings: Mapping[str, Any], page: str, lenses: Step) -> tuple[str, str]:
    """Print a cube, with a marker for the floor, and a board; gives the names of their descriptions, next to which PDF files lie.

    Args:
        settings: ``marker_mm`` of the cube; ``columns``, ``rows`` and ``square_mm`` of the board. lenses: a step for it.

    Raises:
        PosefuseError: targets that cannot be, that do not fit on the page, or that cannot serve.
    """
    if {"marker_mm", "columns", "rows", "square_mm"} - settings.keys():
        raise InputError("targets: expected a number in each field")
    board = {**settings, "kind": "charuco", "marker_mm": 0.75 * settings["square_mm"]}
    cube = {"kind": "markers", "marker_mm": settings["marker_mm"], "ids": _CUBE_IDS}
    sizes_m = {f"{name}_m": board[f"{name}_mm"] / 1e3 for name in ("square", "marker")}
    check_target(Charuco(columns=board["columns"], rows=board["rows"], **sizes_m), lenses)
    named = {f"cube {cube['marker_mm']:g} mm": cube, f"board {board['columns']}x{board['rows']} {board['square_mm']:g} mm": board}
    place = workspace.folder(FOLDER)
    made = [pf.print_target(place / f"{name}.pdf", one, page=page, replace=True) for name, one in named.items()]
    return workspace.name_of(made[0].target), workspace.name_of(made[1].target)


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
