"""Named points of one person over time: what files of other systems hold."""

from __future__ import annotations

import csv
import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posefuse.core import InputError, ShapeError
from posefuse.core.arrays import Array, frozen_fields
from posefuse.core.errors import choices
from posefuse.foundation.parsing import one_line, read_text, short


@dataclass(frozen=True, eq=False, kw_only=True)
class NamedPoints:
    """Named points over time.

    Attributes:
        names: K points. t_s: (T,) seconds as in the file. xyz_world: (T, K, 3) metres, Z up; NaN where missing.
    """

    names: tuple[str, ...]
    t_s: Array
    xyz_world: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        sizes = frozen_fields(self, {"t_s": "T", "xyz_world": "T K 3"})
        if sizes["K"] != len(self.names):
            raise ShapeError(f"{type(self).__name__}: {len(self.names)} names for {sizes['K']} points")


# Named points over time in CSV: one row per time step (wide), or one row per time step, person and keypoint (long).
#
# As spreadsheets save it in any country: separated by comma, semicolon or tab; with ``;`` and tab numbers may have decimal
# commas.

_DELIMITERS = ",;\t"
_LONG_COLUMNS = {"t_s", "person", "keypoint", "x_m", "y_m", "z_m"}
# rows x columns of a long table whose times or keypoints are damaged could fill all memory
_MOST_VALUES = 200_000_000


def read_points_csv(path: Path, person: int | None = None) -> NamedPoints:
    """Read ``pose.csv`` (`outputs.data_files`), or a table of columns t_s, NAME_x, NAME_y, NAME_z in metres.

    Args:
        path: the file.
        person: of a long table; None takes the one seen longest.

    Raises:
        InputError: it cannot be read, lacks columns, holds something other than numbers, or has no such person.
    """
    table = _Table(path)
    return _long(table, person) if set(table.columns) >= _LONG_COLUMNS else _wide(table)


class _Table:
    """Cells by column name and row."""

    def __init__(self, path: Path) -> None:
        self.path = path
        lines = [line for line in read_text(path).splitlines() if line.strip() and not line.startswith("#")]
        delimiter = max(_DELIMITERS, key=lines[0].count) if lines else ","
        try:
            rows = list(csv.reader((line.replace("\0", "") for line in lines), delimiter=delimiter))
        except csv.Error as error:
            raise InputError(f"{path}: cannot be read as CSV ({error})") from None
        if len(rows) < 2:
            raise InputError(f"{path}: expected a header and rows, got {len(rows)} lines")
        self.columns = [name.strip() for name in rows[0]]
        self._rows, self._decimal_comma = rows[1:], delimiter != ","

    def __len__(self) -> int:
        return len(self._rows)

    def text(self, name: str) -> list[str]:
        """Cells of a column; empty where a row ends before it."""
        place = self.columns.index(name)
        return [row[place].strip() if place < len(row) else "" for row in self._rows]

    def numbers(self, name: str) -> Array:
        """(rows,) numbers of a column; NaN where a cell is empty or infinite."""
        cells = self.text(name)
        values = np.array([self._number(cell, name, row) for row, cell in enumerate(cells)], np.float64)
        return np.where(np.isfinite(values), values, np.nan)

    def _number(self, cell: str, column: str, row: int) -> float:
        text = cell.replace(",", ".") if self._decimal_comma else cell
        try:
            return float(text) if text else math.nan
        except ValueError:
            raise InputError(f"{self.path}: row {row + 2}, column {column}: expected a number, got {short(cell)}") from None


def _wide(table: _Table) -> NamedPoints:
    ends = [column for column in dict.fromkeys(table.columns) if column.endswith("_x")]
    names = [end[:-2] for end in ends if {f"{end[:-2]}_y", f"{end[:-2]}_z"} <= set(table.columns)]
    if not names or "t_s" not in table.columns:
        got = choices(short(column) for column in table.columns[:8])
        raise InputError(f"{table.path}: expected columns t_s, NAME_x, NAME_y, NAME_z in metres, got {got}")
    xyz = np.stack([np.stack([table.numbers(f"{name}_{axis}") for axis in "xyz"], axis=-1) for name in names], axis=1)
    return _in_order(table.path, names, table.numbers("t_s"), xyz)


def _long(table: _Table, person: int | None) -> NamedPoints:
    ids = table.numbers("person")
    people = np.unique(ids[np.isfinite(ids)])
    if not len(people) or (person is not None and person not in people):
        there = choices(f"{one:g}" for one in people)
        raise InputError(f"{table.path}: no person {'' if person is None else person}; there are: {there}")
    if person is None:
        known = np.isfinite(table.numbers("x_m"))
        person = max(people.tolist(), key=lambda one: int((known & (ids == one)).sum()))
    mine = np.flatnonzero(ids == person)
    keypoints = [table.text("keypoint")[i] for i in mine]
    times, place_t = np.unique(table.numbers("t_s")[mine], return_inverse=True)
    names = list(dict.fromkeys(keypoints))
    if len(times) * len(names) > _MOST_VALUES:
        raise InputError(f"{table.path}: {len(times)} times of {len(names)} keypoints are more than can be a recording")
    place_k = [names.index(name) for name in keypoints] if len(names) < len(mine) else list(range(len(names)))
    xyz = np.full((len(times), len(names), 3), np.nan)
    xyz[place_t, place_k] = np.stack([table.numbers(f"{axis}_m")[mine] for axis in "xyz"], axis=-1)
    return _in_order(table.path, names, times, xyz)


def _in_order(path: Path, names: Sequence[str], t_s: Array, xyz_m: Array) -> NamedPoints:
    known = np.isfinite(t_s)
    t_s, xyz_m = t_s[known], xyz_m[known]
    if not len(t_s) or (np.diff(t_s) <= 0).any():
        raise InputError(f"{path}: t_s: expected increasing times in seconds")
    return NamedPoints(names=tuple(names), t_s=t_s, xyz_world=xyz_m)


# MVNX: what Xsens suits export. The origins of segments are joint centres; metres, Z up.

# the segment of an MVNX file whose origin is this joint
_JOINTS = {
    "pelvis": "mid_hip", "neck": "neck", "head": "head",
    **{f"{side}{segment}": f"{side}_{joint}" for side in ("left", "right") for segment, joint in (
        ("upperarm", "shoulder"), ("forearm", "elbow"), ("hand", "wrist"),
        ("upperleg", "hip"), ("lowerleg", "knee"), ("foot", "ankle"), ("toe", "big_toe"),
    )},
}  # fmt: skip


def read_mvnx(path: Path) -> NamedPoints:
    """Read the joint centres of a file; raises InputError for one that is not MVNX or has none of the segments."""
    labels: list[str] = []
    times, positions = [], []
    try:
        for _event, element in ET.iterparse(path):
            tag = element.tag.rpartition("}")[2]
            if tag == "segment" and element.get("label"):
                labels.append(str(element.get("label")))
            elif tag == "frame":
                text = next((child.text for child in element if child.tag.rpartition("}")[2] == "position"), None)
                if element.get("type") == "normal" and text:
                    times.append(float(element.get("time", "nan")) / 1000)
                    positions.append([float(number) for number in text.split()])
                element.clear()
    except (ET.ParseError, ValueError, OSError, RecursionError) as error:
        raise InputError(f"{path}: not an MVNX file ({one_line(error)})") from None
    if not positions or {len(row) for row in positions} != {3 * len(labels)}:
        raise InputError(f"{path}: expected frames with a position of each of {len(labels)} segments")
    known = [(i, _JOINTS[label.lower()]) for i, label in enumerate(labels) if label.lower() in _JOINTS]
    if not known:
        raise InputError(f"{path}: expected segments such as {choices(list(_JOINTS)[:4])}, got {choices(labels[:8])}")
    xyz = np.array(positions).reshape(len(times), -1, 3)[:, [i for i, _name in known]]
    return NamedPoints(names=tuple(name for _i, name in known), t_s=np.array(times), xyz_world=xyz)
