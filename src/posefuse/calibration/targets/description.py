"""A target in words and millimetres: the file that `posefuse calibrate print` writes, and that every other step takes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, get_args

from posefuse.core import ConfigError, InputError, PosefuseError
from posefuse.core.errors import choices
from posefuse.foundation.atomic import write_text
from posefuse.foundation.output_file import keep_copy
from posefuse.foundation.settings import read_mapping, read_settings, settings

from .kinds import ArucoBoard, Charuco, Chessboard, Markers, Target

TargetKind = Literal["markers", "charuco", "chessboard", "aruco-board"]
_MM = 1e3


@settings
class TargetDescription:
    """The contents of a target file.

    Attributes:
        kind: what it is. columns, rows: squares (charuco), inner corners (chessboard) or markers (aruco-board).
        square_mm, marker_mm, gap_mm: edge of a square, of a marker's black square, and the white between two markers.
        dictionary: OpenCV's name of the marker dictionary. ids: markers of the target; of an aruco-board the first.
        inverted: black and white are exchanged. legacy: ChArUco layout of OpenCV before 4.6.
        thickness_mm: distance of the prints of a board that is printed on both sides.
    """

    kind: TargetKind
    columns: int | None = None
    rows: int | None = None
    square_mm: float | None = None
    marker_mm: float | None = None
    gap_mm: float | None = None
    thickness_mm: float | None = None
    dictionary: str = "DICT_4X4_50"
    ids: tuple[int, ...] = ()
    inverted: bool = False
    legacy: bool = False


def described_target(said: TargetDescription, missing: Callable[[list[str]], PosefuseError]) -> Target:
    """The target described.

    Args:
        missing: the error to raise for fields that this kind needs and that are None, by their names.
    """

    def need(*names: str) -> list[Any]:
        absent = [name for name in names if getattr(said, name) is None]
        if absent:
            raise missing(absent)
        return [getattr(said, name) / _MM if name.endswith("_mm") else getattr(said, name) for name in names]

    if said.thickness_mm is not None and said.kind not in ("charuco", "aruco-board"):
        raise ConfigError(f"target: thickness_mm: only a charuco or an aruco-board has a back side, this is {said.kind}")
    thickness = None if said.thickness_mm is None else said.thickness_mm / _MM
    if said.kind == "markers":
        (side,) = need("marker_mm")
        return Markers(side, said.dictionary, said.ids, said.inverted)
    if said.kind == "charuco":
        columns, rows, square, marker = need("columns", "rows", "square_mm", "marker_mm")
        return Charuco(
            columns=columns,
            rows=rows,
            square_m=square,
            marker_m=marker,
            dictionary=said.dictionary,
            inverted=said.inverted,
            legacy=said.legacy,
            thickness_m=thickness,
        )
    if said.kind == "chessboard":
        columns, rows, square = need("columns", "rows", "square_mm")
        return Chessboard(columns, rows, square)
    columns, rows, side, gap = need("columns", "rows", "marker_mm", "gap_mm")
    return ArucoBoard(
        columns=columns,
        rows=rows,
        side_m=side,
        gap_m=gap,
        dictionary=said.dictionary,
        first_id=said.ids[0] if said.ids else 0,
        inverted=said.inverted,
        thickness_m=thickness,
    )


def description_of(target: Target) -> TargetDescription:
    """The other way round."""
    match target:
        case Markers():
            return TargetDescription(
                kind="markers",
                marker_mm=_mm(target.side_m),
                dictionary=target.dictionary,
                ids=tuple(target.ids),
                inverted=target.inverted,
            )
        case Charuco():
            return TargetDescription(
                kind="charuco",
                columns=target.columns,
                rows=target.rows,
                square_mm=_mm(target.square_m),
                marker_mm=_mm(target.marker_m),
                dictionary=target.dictionary,
                inverted=target.inverted,
                legacy=target.legacy,
                thickness_mm=_thickness_mm(target),
            )
        case Chessboard():
            return TargetDescription(kind="chessboard", columns=target.columns, rows=target.rows, square_mm=_mm(target.square_m))
        case ArucoBoard():
            return TargetDescription(
                kind="aruco-board",
                columns=target.columns,
                rows=target.rows,
                marker_mm=_mm(target.side_m),
                gap_mm=_mm(target.gap_m),
                dictionary=target.dictionary,
                ids=(target.first_id,) if target.first_id else (),
                inverted=target.inverted,
                thickness_mm=_thickness_mm(target),
            )


def read_target(path: Path) -> Target:
    """The target of a file that `write_target` or a person wrote.

    Raises:
        ConfigError: it cannot be read, has an unknown key, or lacks a size that this kind of target needs.
    """
    if "kind" not in read_mapping(path):
        raise ConfigError(
            f"{path}: not a target file: expected kind = {choices(get_args(TargetKind))}; `calibrate print` writes one"
        )
    said = read_settings(path, TargetDescription)
    return described_target(said, lambda names: ConfigError(f"{path}: {said.kind}: missing {', '.join(names)}"))


def write_target(path: Path, target: Target) -> None:
    """The file; an older one is kept as NAME.replaced-TIME. Raises InputError where it cannot be written."""
    said = description_of(target)
    lines = [
        f"# A calibration target. Give this file to the steps of `posefuse calibrate`: --target {path.name}",
        "# Measure the print: where its sizes differ from these, correct them here.",
    ]
    for field in fields(TargetDescription):
        value = getattr(said, field.name)
        if value is not None and value != () and value is not False:
            lines.append(f"{field.name} = {json.dumps(value)}")
    try:
        keep_copy(path)
        write_text(path, "\n".join(lines) + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


def _thickness_mm(target: Charuco | ArucoBoard) -> float | None:
    return None if target.thickness_m is None else _mm(target.thickness_m)


def _mm(metres: float) -> float:
    return round(metres * _MM, 6)
