"""Options of `posefuse record`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from .calibration import MOST_S, OptionalFile
from .live import SOURCE_HELP
from .shared import CAMERAS, positive


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class RecordOptions:
    """The cameras, and where their videos go."""

    source: Annotated[
        tuple[str, ...], Parameter(metavar="CAMERA=KIND:WHERE", help=SOURCE_HELP, group=CAMERAS, required=True)
    ] = ()
    out: Annotated[Path, Parameter(metavar="SESSION")]
    """New folder: videos/CAMERA.mp4 and recording.toml."""
    rig: OptionalFile = None
    """Rig file to put into the session; frames must have its sizes."""
    duration: Annotated[float | None, Parameter(metavar="S"), positive(MOST_S)] = None
    """Stop after so many seconds; else at Ctrl-C, or when the sources end."""
    view: bool = False
    """Show the images in the Rerun viewer (extra: viewer)."""
    view_file: Annotated[Path | None, Parameter(metavar="FILE.rrd")] = None
    """Write what the viewer would show to a file."""
