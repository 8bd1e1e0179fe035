"""Options of `posefuse batch`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from .shared import count

_MOST_JOBS = 1024


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class BatchOptions:
    """What `posefuse batch` makes, and where it runs."""

    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder for the results; run the same command again to continue."""
    outputs: Annotated[str | None, Parameter(metavar="A,B,...")] = None
    """Which files to write for each trial (default trc,c3d,csv); `posefuse plugins` lists them."""
    no_report: bool = False
    """Do not write joint angles, gait and the report of each trial."""
    jobs: Annotated[int | None, Parameter(metavar="N"), count(_MOST_JOBS)] = None
    """Trials at once (default: as many as the cores and the free memory allow)."""
    scheduler: Annotated[str | None, Parameter(metavar="ADDRESS")] = None
    """Run the trials on this Dask cluster, e.g. tcp://host:8786 (extra: cluster). It must see the same folders."""
    force: bool = False
    """Run trials again that were completed with other settings or from other files."""
