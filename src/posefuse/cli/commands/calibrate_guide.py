"""`posefuse calibrate guide`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from .calibrate_options import MOST_S, MarkerTargetOptions, ReplaceOptions, RigFile
from .options import Figures, Shown, positive


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class GuideOptions(ReplaceOptions):
    """The cameras, and where the coverage is shown."""

    intrinsics: RigFile
    """Rig file with the cameras' names."""
    source: Annotated[tuple[str, ...], Parameter(metavar="CAMERA=KIND:WHERE", required=True)]
    """One per camera, as in `posefuse live`."""
    duration: Annotated[float | None, Parameter(metavar="S"), positive(MOST_S)] = None
    """Stop after so many seconds at the latest."""
    view: bool = False
    """Show the coverage in the Rerun viewer (extra: viewer)."""
    view_file: Annotated[Path | None, Parameter(metavar="FILE.rrd")] = None
    """Write what the viewer would show to a file."""


def calibrate_guide(*, target: MarkerTargetOptions = MarkerTargetOptions(), options: GuideOptions, terminal: Shown) -> Figures:
    """Show live, while you move the target, how much of each image is covered and what is still missing."""
    from posefuse.cli.calibrating.guiding import guide_at_cameras

    return guide_at_cameras(target, options, terminal)
