"""Tables of numbers as CSV: a header, then rows; no more digits than were measured; what is missing is an empty cell."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from posefuse.core import JointAngles
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


# Joint angles as one table: a row per time step and person, degrees at this door.

# microseconds; ten thousandths of a degree
_TIME_DIGITS, _DIGITS = 6, 4


def write_angles(path: Path, joints: JointAngles) -> None:
    """Write CSV: t_s, person, then ``joint.angle_deg`` and ``joint.angle_sigma_deg`` per angle; the unknown is an empty cell."""
    times, people = joints.angle_rad.shape[:2]
    columns: dict[str, Iterable[float | None]] = {
        "t_s": rounded(np.repeat(joints.t_ns / 1e9, people), _TIME_DIGITS),
        "person": itertools.chain.from_iterable(itertools.repeat(joints.person_id.tolist(), times)),
    }
    for q, (joint, names) in enumerate(zip(joints.joints, joints.angle_names, strict=True)):
        for a, angle in enumerate(names):
            columns[f"{joint}.{angle}_deg"] = rounded(joints.angle_rad[:, :, q, a], _DIGITS, np.degrees)
            columns[f"{joint}.{angle}_sigma_deg"] = rounded(joints.sigma_rad[:, :, q, a], _DIGITS, np.degrees)
    write_columns(path, columns)
