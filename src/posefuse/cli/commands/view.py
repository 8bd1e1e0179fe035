"""`posefuse view`: look at a result."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from .options import Figures, Shown


def view(result: Annotated[Path, Parameter(metavar="DIR")], /, *, terminal: Shown) -> Figures:
    """Show a result in the Rerun viewer (extra: viewer), until the viewer is closed.

    Args:
        result: Folder written by `posefuse track`.
    """
    from posefuse.outputs import view_recording

    return {"viewed": view_recording(result)}
