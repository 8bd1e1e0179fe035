"""Motions of OpenSim by column: those that are written, and those in a file."""

from pathlib import Path

import numpy as np

from posefuse.formats.mot import MotTable


def columns_of(motion: MotTable | Path) -> dict[str, np.ndarray]:
    """Values (T,) by name, and the times under ``time``."""
    if isinstance(motion, MotTable):
        return {"time": motion.t_s, **dict(zip(motion.columns, motion.values.T, strict=True))}
    lines = motion.read_text().splitlines()
    begin = lines.index("endheader") + 1
    return dict(zip(lines[begin].split(), np.loadtxt(lines[begin + 1 :], ndmin=2).T, strict=True))
