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

    source: Annotated[tuple[str, ...], Parameter(metavar="CAMERA=KIND:WHERE", help=SOURCE_HELP, group=CAMERAS)] = ()
    out: Annotated[Path, Parameter(metavar="SESSION")]
    """New folder: videos/CAMERA.mp4 and recording.toml."""
    rig: OptionalFile = None
    """Rig file to put into the session; frames must have its sizes."""
    duration: Annotated[float | None, Parameter(metavar="S"), positive(MOST_S)] = None
    """Stop so many seconds after the first frame of the last camera; else at Ctrl-C, or when the sources end."""
    resume: bool = False
    """Complete the recording of SESSION that was interrupted; no cameras are opened."""
