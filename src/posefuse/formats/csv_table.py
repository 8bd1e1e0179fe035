"""Tables of numbers as CSV: a header, then rows; no more digits than were measured; what is missing is an empty cell."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from posefuse.core.arrays import Array
from posefuse.foundation.output_file import atomic_file

_PART_ROWS = 1000


def write_columns(path: Path, columns: Mapping[str, Iterable[object]]) -> None:
    """Write columns of one length by name; raises InputError when the file cannot be written."""
    with atomic_file(path) as staged, staged.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(columns)
        rows.writerows(zip(*columns.values(), strict=True))


def rounded(values: Array, digits: int, converted: Callable[[Array], Array] = np.asarray) -> Iterator[float | None]:
    """The numbers of an array of any shape, in its order; None where one is NaN. They are made as they are written."""
    for start in range(0, len(values), _PART_ROWS):
        part = converted(values[start : start + _PART_ROWS])
        # zero has no sign
        yield from (None if number != number else number for number in (np.round(part, digits) + 0.0).ravel().tolist())
