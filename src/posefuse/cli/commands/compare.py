"""`posefuse compare`: two recordings of one movement, by whatever systems."""

from __future__ import annotations

from pathlib import Path

from posefuse.cli.options.compare import CompareOptions
from posefuse.cli.options.shared import Figures, Shown


def compare(a: Path, b: Path, /, *, options: CompareOptions = CompareOptions(), terminal: Shown) -> Figures:
    """Compare two recordings (posefuse result or .mcap, TRC, C3D, CSV, MVNX): aligned in time and space, error per point, drift.

    Args:
        a: The reference: result folder, .mcap, .trc, .c3d, .csv or .mvnx; or a folder of posefuse simulate, whose truth is then
            compared by simulation time, without alignment.
        b: The recording to align with A.
    """
    from posefuse.cli.comparing import compare_files

    return compare_files(a, b, options, terminal)
