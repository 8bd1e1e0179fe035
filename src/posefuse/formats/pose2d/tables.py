"""Tables of other tools whose columns are named points of individuals: shared by the csv and h5 forms of DeepLabCut."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posefuse.core import InputError, Skeleton
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import short

from .frames import People2D, Pose2DFrames, frames_from_mapping
from .keypoint_sets import skeleton_of_names

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
