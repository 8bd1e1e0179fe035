"""Joint angles as one table: a row per time step and person, degrees at this door."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from posefuse.core import JointAngles

from .csv_table import rounded, write_columns

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
