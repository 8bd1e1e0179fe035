"""Calibration targets: markers and boards, the positions of their corners, and target files.

A target is made of patches, each a rigid flat piece with numbered corners. Loose square markers are one patch each,
named by their id, and where they sit on the prop is unknown; a board is a patch of known geometry, number 0.
Patch axes: x right, y up, z out of the printed face, metres.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np

from posefuse.calibration.settings import TargetDescription, TargetKind
from posefuse.core import CalibrationError, ConfigError, PosefuseError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.foundation.output_file import keep_copy, write_text
from posefuse.foundation.settings import read_mapping, read_settings

DICTIONARIES = tuple(sorted(name for name in vars(cv2.aruco) if name.startswith("DICT_") and name == name.upper()))
BOARD_PATCH = 0
# corners of a marker of side 1: top left, top right, bottom right, bottom left
_MARKER = np.array([[-0.5, 0.5, 0], [0.5, 0.5, 0], [0.5, -0.5, 0], [-0.5, -0.5, 0]])


def dictionary_of(name: str) -> Any:
    """OpenCV's predefined dictionary; raises ConfigError naming those that exist."""
    if name not in DICTIONARIES:
        raise ConfigError(f"marker dictionary: unknown name {name!r}; there are: {choices(DICTIONARIES)}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def black_modules(dictionary: Any, marker: int) -> Array:
    """(n, n) bool, True where a marker of OpenCV's dictionary is black, border included."""
    return np.asarray(dictionary.generateImageMarker(marker, dictionary.markerSize + 2) < 128)


def board_picture(board: Any, square_px: int) -> Array:
    """(H, W) share of white in each pixel of one of OpenCV's ChArUco boards, whose own pictures move markers by up to a pixel."""
    columns, rows = board.getChessboardSize()
    picture = np.kron(np.indices((rows, columns)).sum(axis=0) % 2, np.ones((square_px, square_px)))
    for marker_id, corners in zip(np.ravel(board.getIds()).tolist(), np.array(board.getObjPoints(), np.float64), strict=True):
        black = black_modules(board.getDictionary(), marker_id)
        edges_px = np.linspace(corners[0, :2], corners[2, :2], len(black) + 1) / board.getSquareLength() * square_px
        first, end = np.floor(edges_px[0]).astype(int), np.ceil(edges_px[-1]).astype(int)
        across, down = (_covered(edges_px[:, axis], np.arange(first[axis], end[axis])) for axis in (0, 1))
        picture[first[1] : end[1], first[0] : end[0]] -= down @ black @ across.T
    return picture


def _covered(edges_px: Array, pixel: Array) -> Array:
    """(pixels, cells) share of each pixel of a row that lies between each two neighbouring edges."""
    return np.diff(np.clip(edges_px, pixel[:, None], pixel[:, None] + 1), axis=1)


def _check_positive(owner: str, **values: float) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise ConfigError(f"{owner}: {name}: expected > 0, got {value}")


@dataclass(frozen=True)
class Markers:
    """Square ArUco markers of one side length, anywhere on a rigid prop of unknown geometry.

    Attributes:
        side_m: outer edge of the black square.
        dictionary: OpenCV's name, e.g. ``DICT_4X4_50``.
        ids: markers that belong to the target; empty takes all of the dictionary.
        inverted: white squares on black.
    """

    side_m: float
    dictionary: str = "DICT_4X4_50"
    ids: tuple[int, ...] = ()
    inverted: bool = False

    def __post_init__(self) -> None:
        _check_positive("markers", side_m=self.side_m)
        _check_ids("markers", self.dictionary, self.ids)
        if len(set(self.ids)) < len(self.ids):
            raise ConfigError(f"markers: ids: expected each once, got {', '.join(map(str, self.ids))}")

    def corners(self, patch: int) -> Array:
        """(4, 3) corners of a marker in its own frame: top left, top right, bottom right, bottom left."""
        return _MARKER * self.side_m


@dataclass(frozen=True, kw_only=True)
class Charuco:
    """Chessboard with ArUco markers in its white squares.

    Attributes:
        columns, rows: squares across and down.
        square_m, marker_m: edges of a square and of a marker.
        inverted: colours exchanged. legacy: OpenCV's layout before version 4.6 (matters for an even number of rows).
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float
    dictionary: str = "DICT_4X4_50"
    inverted: bool = False
    legacy: bool = False

    def __post_init__(self) -> None:
        _check_positive("charuco", square_m=self.square_m, marker_m=self.marker_m)
        _check_count("charuco", 2, columns=self.columns, rows=self.rows)
        if self.marker_m >= self.square_m:
            square_mm, marker_mm = round(self.square_m * 1e3, 6), round(self.marker_m * 1e3, 6)
            raise ConfigError(f"charuco: marker of {marker_mm:g} mm: expected less than the square of {square_mm:g} mm around it")
        _check_ids("charuco", self.dictionary, (0, self.columns * self.rows // 2 - 1))

    def corners(self, patch: int) -> Array:
        """((columns-1)*(rows-1), 3) inner corners, row by row from the top left; the origin is the bottom left of the board."""
        return np.asarray(_grid(self.columns - 1, self.rows - 1, self.square_m) + np.array([self.square_m, self.square_m, 0]))

    def board(self) -> Any:
        """OpenCV's description of the same board."""
        size = self.columns, self.rows
        made = cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m, dictionary_of(self.dictionary))
        made.setLegacyPattern(self.legacy)
        return made


@dataclass(frozen=True)
class Chessboard:
    """Plain chessboard of columns x rows inner corners.

    It looks the same after half a turn, so it serves intrinsics and not extrinsics.
    """

    columns: int
    rows: int
    square_m: float

    def __post_init__(self) -> None:
        _check_positive("chessboard", square_m=self.square_m)
        _check_count("chessboard", 3, columns=self.columns, rows=self.rows)

    def corners(self, patch: int) -> Array:
        """(columns*rows, 3) inner corners, row by row from the top left."""
        return _grid(self.columns, self.rows, self.square_m)


Target = Markers | Charuco | Chessboard


def _check_ids(owner: str, dictionary: str, ids: Sequence[int]) -> None:
    count = len(dictionary_of(dictionary).bytesList)
    if any(not 0 <= number < count for number in ids):
        used = f"{min(ids)} to {max(ids)}" if len(ids) > 1 else f"{ids[0]}"
        raise ConfigError(
            f"{owner}: {dictionary} has markers 0 to {count - 1}, this target needs {used}; take a smaller target, a larger "
            "dictionary or other ids"
        )


def _check_count(owner: str, least: int, **counts: int) -> None:
    for name, count in counts.items():
        if count < least:
            raise ConfigError(f"{owner}: {name}: expected at least {least}, got {count}")


def scale_m(target: Target) -> float:
    """The length everything else is measured by: edge of a marker, or of a board's square."""
    return target.side_m if isinstance(target, Markers) else target.square_m


def patch_corners(target: Target, patches: Array) -> Array:
    """(M, n, 3) corners of each patch of a target in its own frame."""
    return np.stack([target.corners(int(patch)) for patch in patches])


def in_a_plane(points: Array) -> bool:
    """Whether corners (n, 3) of a target span a plane; those of one row of a board have no pose."""
    return bool(np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-9) >= 2)


def _grid(columns: int, rows: int, step_m: float) -> Array:
    """(columns*rows, 3) points row by row from the top left; the last row lies on y = 0."""
    row, column = np.divmod(np.arange(columns * rows), columns)
    return np.stack([column, rows - 1 - row, np.zeros_like(row)], axis=-1) * step_m


# views from which intrinsics can be calibrated, and corners in each of them
LEAST_VIEWS, LEAST_CORNERS = 4, 8


def check_board(target: Target) -> None:
    """Raise CalibrationError for a target from which no intrinsics can be calibrated, however it is shown."""
    if isinstance(target, Markers):
        raise CalibrationError("target: intrinsics need a board; loose markers serve extrinsics")
    corners = len(target.corners(BOARD_PATCH))
    if corners < LEAST_CORNERS:
        raise CalibrationError(
            f"target: expected a board with at least {LEAST_CORNERS} corners for intrinsics, got {corners} on one of"
            f" {target.columns} x {target.rows}; take one with more squares"
        )


def check_one_end(target: Target) -> None:
    """Raise CalibrationError for a target whose corners two cameras may count from different ends."""
    if isinstance(target, Chessboard):
        raise CalibrationError("target: a plain chessboard looks the same from both ends; use a ChArUco board or markers")


_MM = 1e3
_KINDS: Mapping[TargetKind, type[Target]] = {"markers": Markers, "charuco": Charuco, "chessboard": Chessboard}


def described_target(said: TargetDescription, missing: Callable[[list[str]], PosefuseError]) -> Target:
    """The target described.

    Args:
        missing: the error to raise for fields that this kind needs and that are None, by their names.
    """
    kind = _KINDS[said.kind]
    stated = {field.name: getattr(said, _stated(field.name)) for field in fields(kind)}
    others = [one for one in fields(TargetDescription) if one.name not in ("kind", *map(_stated, stated))]
    unused = [one.name for one in others if getattr(said, one.name) != one.default]
    if unused:
        raise ConfigError(
            f"target: {choices(unused)}: a target of kind {said.kind} has none; it has {choices(map(_stated, stated))}"
        )
    absent = [_stated(field.name) for field in fields(kind) if field.default is MISSING and stated[field.name] is None]
    if absent:
        raise missing(absent)
    return kind(**{name: value / _MM if name.endswith("_m") else value for name, value in stated.items()})


def description_of(target: Target) -> TargetDescription:
    """The other way round."""
    kind = next(name for name, one in _KINDS.items() if isinstance(target, one))
    values: dict[str, Any] = {field.name: getattr(target, field.name) for field in fields(target)}
    said = {_stated(name): round(one * _MM, 6) if name.endswith("_m") else one for name, one in values.items()}
    return TargetDescription(kind=kind, **said)


def _stated(name: str) -> str:
    """The key in the file of a field of a target: lengths are stated in mm."""
    if name == "side_m":
        return "marker_mm"
    return f"{name}m" if name.endswith("_m") else name


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


def write_target(path: Path, target: Target) -> Path:
    """The file, which is returned; an older one is kept as NAME.replaced-TIME. Raises InputError where it cannot be written."""
    said = description_of(target)
    lines = [
        f"# A calibration target. Give this file to the steps of `posefuse calibrate`: --target {path.name}",
        "# Measure the print: where its sizes differ from these, correct them here.",
    ]
    for field in fields(TargetDescription):
        value = getattr(said, field.name)
        if value is not None and value != () and value is not False:
            lines.append(f"{field.name} = {json.dumps(value)}")
    keep_copy(path)
    write_text(path, "\n".join(lines) + "\n")
    return path
