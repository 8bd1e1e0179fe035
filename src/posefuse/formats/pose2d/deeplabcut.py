"""DeepLabCut: csv with three or four header lines, and h5 (a pandas table), of one or several individuals."""

from __future__ import annotations

import csv
import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import InputError, Skeleton

from .frames import Pose2DFrames
from .h5 import H5_SUFFIXES, opened
from .tables import column_of, frames_of_table

NAME = "deeplabcut"
_KEY = "df_with_missing"
_HEADER = ("scorer", "individuals", "bodyparts", "coords")


def fits(path: Path) -> bool:
    """Whether this is a csv that begins with ``scorer``, or an h5 with DeepLabCut's table."""
    if not path.is_file():
        return False
    if path.suffix == ".csv":
        with path.open(encoding="utf-8", errors="replace") as file:
            return file.readline().partition(",")[0].strip() == "scorer"
    if path.suffix not in H5_SUFFIXES:
        return False
    with opened(path) as file:
        return f"{_KEY}/table" in file


def read(path: Path, camera: str, skeleton: Skeleton | None = None) -> Pose2DFrames:
    """Frames by the table's index.

    Raises:
        InputError: a table that is not DeepLabCut's. DependencyError: an h5 without the extra ``h5``.
    """
    return _read_csv(path, camera, skeleton) if path.suffix == ".csv" else _read_h5(path, camera, skeleton)


def _read_csv(path: Path, camera: str, skeleton: Skeleton | None) -> Pose2DFrames:
    with path.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.reader(file) if row]
    count = next((i for i, row in enumerate(rows) if row[0].strip() not in _HEADER), len(rows))
    header, body = rows[:count], rows[count:]
    if not body:
        raise InputError(f"{path}: expected rows of frames below the header, got none")
    columns = [column_of([line[i].strip() for line in header], str(path)) for i in range(1, len(header[0]))]
    try:
        numbers = [int(float(row[0])) for row in body]
        values = np.array([[float(cell) if cell.strip() else np.nan for cell in row[1:]] for row in body])
    except ValueError as error:
        raise InputError(f"{path}: expected a frame number and numbers in every row ({error})") from None
    return frames_of_table(numbers, columns, values, camera=camera, tool=NAME, where=str(path), skeleton=skeleton)


def _read_h5(path: Path, camera: str, skeleton: Skeleton | None) -> Pose2DFrames:
    with opened(path) as file:
        table = file[f"{_KEY}/table"]
        names = [name for name in table.dtype.names if name.startswith("values_block")]
        if len(names) != 1:
            raise InputError(f"{path}: expected all columns of {_KEY} to be of one type, got {len(names)} types")
        header = _column_names(bytes(table.attrs[f"{names[0]}_kind"]), path)
        content = table[()]
    columns = [column_of(line, str(path)) for line in header]
    numbers = [int(number) for number in content["index"]]
    return frames_of_table(
        numbers, columns, np.asarray(content[names[0]], np.float64), camera=camera, tool=NAME, where=str(path), skeleton=skeleton
    )


class _PlainUnpickler(pickle.Unpickler):
    """pandas keeps the columns' names pickled: read as plain lists, tuples and strings, and refuse anything that could run."""

    def find_class(self, module: str, name: str) -> Any:
        raise pickle.UnpicklingError(f"{module}.{name} is not a plain value")


def _column_names(pickled: bytes, path: Path) -> list[tuple[str, ...]]:
    try:
        names = _PlainUnpickler(io.BytesIO(pickled)).load()
        return [tuple(str(part) for part in name) for name in names]
    except (pickle.UnpicklingError, EOFError, TypeError, ValueError, IndexError, KeyError) as error:
        raise InputError(f"{path}: the names of its columns cannot be read ({error}); export it as csv") from None
