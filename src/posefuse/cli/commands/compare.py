"""`posefuse compare`: two recordings of one movement, by whatever systems."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from .options import Figures, Shown, positive

MOST_S = 86_400.0


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class CompareOptions:
    """How two recordings are aligned, and where the comparison goes."""

    out: Annotated[Path | None, Parameter(metavar="DIR")] = None
    """Write compare.html and compare.json there."""
    person: Annotated[int | None, Parameter(metavar="ID")] = None
    """Which person of files that hold several."""
    scale: bool = False
    """Find the scale of B, too."""
    no_time: bool = False
    """Do not align in time: both have the times of one clock."""
    no_space: bool = False
    """Do not align in space: both have the coordinates of one system."""
    align_first: Annotated[float | None, Parameter(metavar="S"), positive(MOST_S)] = None
    """Align in space by the first S seconds only, so that drift shows."""


def compare(a: Path, b: Path, /, *, options: CompareOptions = CompareOptions(), terminal: Shown) -> Figures:
    """Compare two recordings (posefuse result, TRC, C3D, CSV, MVNX): aligned in time and space, error per point, drift.

    Args:
        a: The reference: result folder, .trc, .c3d, .csv or .mvnx.
        b: The one that is aligned with A.
    """
    from posefuse.cli.comparing import compare_files

    return compare_files(a, b, options, terminal)
