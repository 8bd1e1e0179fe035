"""Options of `posefuse compare`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from .shared import positive

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
    """Estimate the scale of B, too."""
    no_time: bool = False
    """Do not align in time: both have the times of one clock."""
    no_space: bool = False
    """Do not align in space: both have the coordinates of one system."""
    align_first: Annotated[float | None, Parameter(metavar="S"), positive(MOST_S)] = None
    """Align in space by the first S seconds only, so that drift shows."""
