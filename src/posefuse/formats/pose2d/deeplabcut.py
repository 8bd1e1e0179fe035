"""DeepLabCut: csv with three or four header lines, and h5 (a pandas table), of one or several individuals."""

from __future__ import annotations

import csv
import io
import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import DependencyError, InputError, Skeleton
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import short

from .frames import People2D, Pose2DFrames, frames_from_mapping, skeleton_of_names

# HDF5 files, where the extra for them is installed.

H5_SUFFIXES = (".h5", ".hdf5")


def opened(path: Path) -> Any:
    """The file, to read from; raises DependencyError without the extra, InputError for what is no HDF5 file."""
    try:
        import h5py
    except ImportError:
        raise DependencyError(f"{path}: reading HDF5 needs the package h5py: pip install 'posefuse[h5]'") from None
    try:
        return h5py.File(path, "r")
    except OSError as error:
        raise InputError(f"{path}: not a readable HDF5 file ({str(error).splitlines()[0]})") from None


# Tables of other tools whose columns are named points of individuals: shared by the csv and h5 forms of DeepLabCut.

# a column: individual ("" where there is but one), point, and what of it
Column = tuple[str, str, str]
_COORDINATES = ("x", "y", "likelihood")
_LEAST_HEADER, _MOST_HEADER = 3, 4


def column_of(header: Sequence[str], where: str) -> Column:
    """The column of a header of three (scorer, point, coordinate) or four (with the individual) lines."""
    if not _LEAST_HEADER <= len(header) <= _MOST_HEADER:
        raise InputError(f"{where}: expected columns of 3 or 4 header lines, got {len(header)}")
    individual = header[1] if len(header) == _MOST_HEADER else ""
    return individual, header[-2], header[-1]


def frames_of_table(
    numbers: Sequence[int],
    columns: Sequence[Column],
    values: Array,
    camera: str,
    tool: str,
    where: str,
    skeleton: Skeleton | None,
) -> Pose2DFrames:
    """Frames of a table (F, columns) with x, y and likelihood of each point of each individual.

    An individual is a track: its place among them is its id. Without a likelihood what is there is certain.

    Raises:
        InputError: a point without x or y.
    """
    individuals = list(dict.fromkeys(column[0] for column in columns))
    names = list(dict.fromkeys(column[1] for column in columns))
    made = skeleton or skeleton_of_names(names, tool, where)
    place = {column: i for i, column in enumerate(columns)}
    points = np.full((len(numbers), len(individuals), len(names), 3), np.nan)
    for n, individual in enumerate(individuals):
        for k, name in enumerate(names):
            for c, coordinate in enumerate(_COORDINATES):
                column = place.get((individual, name, coordinate))
                if column is not None:
                    points[:, n, k, c] = values[:, column]
                elif coordinate != "likelihood":
                    raise InputError(f"{where}: point {short(name)}: expected a column {coordinate!r}, got none")
                else:
                    points[:, n, k, c] = np.isfinite(points[:, n, k, 0])
    ids = np.arange(len(individuals))
    return frames_from_mapping(camera, tool, made, {number: People2D(points[i], ids) for i, number in enumerate(numbers)})


NAME = "deeplabcut"
LOOKS_FOR = "csv that begins with scorer, or h5 with df_with_missing"
_KEY = "df_with_missing"
_HEADER = ("scorer", "individuals", "bodyparts", "coords")


def fits(path: Path) -> bool:
    """Whether this is a csv that begins with ``scorer``, or an h5 with DeepLabCut's table."""
    if not path.is_file():
        return False
    if path.suffix == ".csv":
        with path.open(encoding="utf-8-sig", errors="replace") as file:
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
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = [row for row in csv.reader(file) if row]
    for number, row in enumerate(rows, start=1):
        if len(row) != len(rows[0]):
            raise InputError(f"{path}: row {number}: expected {len(rows[0])} columns, got {len(row)}")
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
