"""Joint angles as one table: a row per time step and person, degrees at this door. CSV and Parquet hold the same columns."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from posefuse.core import InputError, JointAngles
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import one_line

if TYPE_CHECKING:
    import pyarrow as pa

_FIRST = ("t_ns", "person_id")


def write_angles(path: Path, joints: JointAngles) -> None:
    """Write ``.csv`` or ``.parquet``: t_ns, person_id, then ``joint.angle_deg`` and ``joint.angle_sigma_deg`` per angle.

    What is unknown is an empty cell. Raises InputError for another ending.
    """
    import pyarrow.csv
    import pyarrow.parquet

    _check_ending(path)
    table = table_from_joints(joints)
    if path.suffix == ".csv":
        pyarrow.csv.write_csv(table, path, pyarrow.csv.WriteOptions(quoting_style="none"))
    else:
        pyarrow.parquet.write_table(table, path)


def read_angles(path: Path) -> dict[str, Array]:
    """The columns of a table written by `write_angles`; NaN where a cell is empty.

    Raises:
        InputError: it cannot be read or is no such table.
    """
    import pyarrow as pa
    import pyarrow.csv
    import pyarrow.parquet

    _check_ending(path)
    try:
        table = pyarrow.csv.read_csv(path) if path.suffix == ".csv" else pyarrow.parquet.read_table(path)
        names = table.column_names
    except (OSError, UnicodeDecodeError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read as a table ({one_line(error)})") from None
    if tuple(names[:2]) != _FIRST:
        raise InputError(f"{path}: expected the first columns {', '.join(_FIRST)}, got {one_line(', '.join(names[:2]))}")
    return {name: _column(path, name, table[name]) for name in names}


def _column(path: Path, name: str, values: pa.ChunkedArray) -> Array:
    kind = np.int64 if name in _FIRST else np.float64
    try:
        cells: Any = values.to_pylist()
        return np.array([np.nan if cell is None else cell for cell in cells], kind)
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{path}: column {one_line(name)}: expected numbers ({one_line(error)})") from None


def table_from_joints(joints: JointAngles) -> pa.Table:
    """The table `write_angles` writes, as Arrow."""
    import pyarrow as pa

    times, people = joints.angle_rad.shape[:2]
    columns: dict[str, Array] = {"t_ns": np.repeat(joints.t_ns, people), "person_id": np.tile(joints.person_id, times)}
    for q, (joint, names) in enumerate(zip(joints.joints, joints.angle_names, strict=True)):
        for a, angle in enumerate(names):
            columns[f"{joint}.{angle}_deg"] = np.degrees(joints.angle_rad[:, :, q, a]).ravel()
            columns[f"{joint}.{angle}_sigma_deg"] = np.degrees(joints.sigma_rad[:, :, q, a]).ravel()
    return pa.table({name: pa.array(values, from_pandas=True) for name, values in columns.items()})


def _check_ending(path: Path) -> None:
    if path.suffix not in (".csv", ".parquet"):
        raise InputError(f"{path}: expected a file ending in .csv or .parquet, got {path.suffix or 'no ending'!r}")
