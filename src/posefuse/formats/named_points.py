"""Named points of one person over time: what files of other systems hold."""

from __future__ import annotations

import csv
import math
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


def read_points_csv(path: Path) -> NamedPoints:
    """Read a table of columns t_s, NAME_x, NAME_y, NAME_z in metres, a row per time step; an empty cell is missing.

    Raises:
        InputError: it cannot be read, lacks columns, or holds something other than numbers.
    """
    try:
        rows = [row for row in csv.reader(read_text(path).splitlines()) if row]
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as CSV ({one_line(error)})") from None
    header = [name.strip() for name in rows[0]] if rows else []
    ends = [column for column in dict.fromkeys(header) if column.endswith("_x")]
    names = [end[:-2] for end in ends if {f"{end[:-2]}_y", f"{end[:-2]}_z"} <= set(header)]
    if not names or "t_s" not in header or len(rows) < 2:
        raise InputError(
            f"{path}: expected rows of columns t_s, NAME_x, NAME_y, NAME_z in metres, separated by commas (of a result of "
            f"posefuse, give its folder), got {len(rows)} lines of {choices(short(column) for column in header[:8])}"
        )
    columns = ["t_s", *(f"{name}_{axis}" for name in names for axis in "xyz")]
    places = [header.index(column) for column in columns]
    table = np.array([_numbers(path, number, row, places) for number, row in enumerate(rows[1:], start=2)])
    return NamedPoints(names=tuple(names), t_s=table[:, 0], xyz_world=table[:, 1:].reshape(len(table), len(names), 3))


def _numbers(path: Path, number: int, row: list[str], places: list[int]) -> list[float]:
    """The cells of a row at these places; NaN where one is empty, or the row ends before it."""
    cells = [row[place].strip() if place < len(row) else "" for place in places]
    try:
        return [float(cell) if cell else math.nan for cell in cells]
    except ValueError as error:
        raise InputError(f"{path}: row {number}: {one_line(error)}") from None
