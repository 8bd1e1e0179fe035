"""OpenSim motion and storage files (.mot, .sto): a header, then one row per time step, tab-separated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posefuse.core import InputError, JointAngles, ShapeError
from posefuse.core.arrays import Array, check_fields, freeze_fields
from posefuse.core.joint_angles import angle_labels
from posefuse.foundation.atomic import write_text
from posefuse.foundation.parsing import one_line, read_text


@dataclass(frozen=True, eq=False, kw_only=True)
class MotTable:
    """Named quantities over time, as OpenSim stores them.

    Attributes:
        name: first line of the file.
        t_s: (T,) seconds, strictly increasing.
        columns: names of axis Q, without ``time``.
        values: (T, Q); NaN where unknown. Angles in degrees when `in_degrees`, else radians; translations in metres.
        in_degrees: unit of the angles.
    """

    name: str
    t_s: Array
    columns: tuple[str, ...]
    values: Array
    in_degrees: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(self.columns))
        freeze_fields(self, dict.fromkeys(("t_s", "values"), np.float64))
        sizes = check_fields(self, {"t_s": "T", "values": "T Q"})
        if sizes["Q"] != len(self.columns) or len(set(self.columns)) != len(self.columns):
            raise ShapeError(f"MotTable: expected {sizes['Q']} different column names, got {len(set(self.columns))}")

    def column(self, name: str) -> Array:
        """(T,) values of one column; raises InputError for a name that is not there."""
        if name not in self.columns:
            raise InputError(f"motion {self.name}: no column {name!r}; there are: {', '.join(self.columns)}")
        return np.asarray(self.values[:, self.columns.index(name)])


def motion_from_joints(joints: JointAngles, person: int = 0, name: str = "posefuse") -> MotTable:
    """One person's angles as columns ``joint_angle`` in degrees, time from the first time step; all-NaN columns are left out."""
    columns = angle_labels(joints, "_")
    values = np.degrees(joints.angle_rad[:, person].reshape(len(joints.t_ns), -1))
    kept = np.flatnonzero(np.isfinite(values).any(axis=0))
    t_s = (joints.t_ns - joints.t_ns[0]) * 1e-9 if len(joints.t_ns) else np.zeros(0)
    return MotTable(name=name, t_s=t_s, columns=tuple(columns[i] for i in kept), values=values[:, kept])


def write_mot(path: Path, motion: MotTable) -> None:
    """Write a .mot or .sto file; unknown values are written as ``nan``, which OpenSim reads."""
    header = [
        motion.name.replace("\n", " "), "version=1", f"nRows={len(motion.t_s)}", f"nColumns={len(motion.columns) + 1}",
        f"inDegrees={'yes' if motion.in_degrees else 'no'}", "endheader", "\t".join(("time", *motion.columns)),
    ]  # fmt: skip
    rows = ("\t".join(f"{number:.10g}" for number in (t, *row)) for t, row in zip(motion.t_s, motion.values, strict=True))
    write_text(path, "\n".join((*header, *rows)) + "\n")


def read_mot(path: Path) -> MotTable:
    """Read a .mot or .sto file.

    Raises:
        InputError: not such a file, or rows that do not fit its columns; names file and line.
    """
    lines = read_text(path).splitlines()
    end = next((i for i, line in enumerate(lines) if line.strip().lower() == "endheader"), None)
    if end is None or end + 1 >= len(lines):
        raise InputError(f"{path}: expected an OpenSim header that ends in 'endheader' and a line of column names; found none")
    names = lines[end + 1].split()
    first = one_line(names[0]) if names else "nothing"
    if first.lower() != "time":
        raise InputError(f"{path}: line {end + 2}: expected the first column 'time', got {first}")
    rows = [_row(path, i, lines[i], len(names)) for i in range(end + 2, len(lines)) if lines[i].strip()]
    table = np.array(rows, np.float64).reshape(-1, len(names))
    return MotTable(
        name=lines[0].strip(), t_s=table[:, 0], columns=tuple(names[1:]), values=table[:, 1:], in_degrees=_in_degrees(lines[:end])
    )


def _row(path: Path, number: int, line: str, count: int) -> Sequence[float]:
    parts = line.split()
    if len(parts) != count:
        raise InputError(f"{path}: line {number + 1}: expected {count} numbers, got {len(parts)}")
    try:
        return [float(part) for part in parts]
    except ValueError as error:
        raise InputError(f"{path}: line {number + 1}: {one_line(error)}") from None


def _in_degrees(header: Sequence[str]) -> bool:
    keys = dict(line.lower().replace(" ", "").split("=", 1) for line in header if "=" in line)
    return keys.get("indegrees", "no") == "yes"
