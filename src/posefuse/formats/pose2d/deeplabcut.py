"""DeepLabCut: csv with three or four header lines, of one or several individuals."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from posefuse.core import InputError, Skeleton
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import short

from .frames import People2D, Pose2DFrames, frames_from_mapping, skeleton_of_names

NAME = "deeplabcut"
LOOKS_FOR = "csv that begins with scorer"
_HEADER = ("scorer", "individuals", "bodyparts", "coords")
# its other form, from which DeepLabCut makes the csv
_TABLE_SUFFIX = ".h5"
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
    numbers: Sequence[int], columns: Sequence[Column], values: Array, camera: str, where: str, skeleton: Skeleton | None
) -> Pose2DFrames:
    """Frames of a table (F, columns) with x, y and likelihood of each point of each individual.

    An individual is a track: its place among them is its id. Without a likelihood what is there is certain.

    Raises:
        InputError: a point without x or y.
    """
    individuals = list(dict.fromkeys(column[0] for column in columns))
    names = list(dict.fromkeys(column[1] for column in columns))
    made = skeleton or skeleton_of_names(names, NAME, where)
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
    return frames_from_mapping(camera, NAME, made, {number: People2D(points[i], ids) for i, number in enumerate(numbers)})


def fits(path: Path) -> bool:
    """Whether this is a csv that begins with ``scorer``, or DeepLabCut's h5, which `read` refuses."""
    if path.suffix != ".csv" or not path.is_file():
        return path.suffix == _TABLE_SUFFIX
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        return file.readline().partition(",")[0].strip() == "scorer"


def read(path: Path, camera: str, skeleton: Skeleton | None = None) -> Pose2DFrames:
    """Frames by the table's index; raises InputError for a table that is not DeepLabCut's, and for its h5."""
    if path.suffix == _TABLE_SUFFIX:
        raise InputError(
            f"{path}: camera {camera}: of DeepLabCut, csv is read: make it with deeplabcut.analyze_videos_converth5_to_csv"
        )
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
    return frames_of_table(numbers, columns, values, camera, str(path), skeleton)
