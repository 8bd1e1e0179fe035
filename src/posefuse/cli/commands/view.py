"""`posefuse view`: look at a result."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from posefuse.cli.options.shared import Figures, Shown


def view(
    result: Annotated[Path, Parameter(metavar="RESULT")],
    /,
    *,
    session: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    terminal: Shown,
) -> Figures:
    """Show a result in the Rerun viewer (extra: viewer), until the viewer is closed.

    Args:
        result: Folder written by `posefuse track`, or the .mcap of `posefuse live --record`.
        session: Session the result was made from, for its images (default: a folder of its name near the result or here).
    """
    from posefuse.cli.viewing import view_result

    return {"viewed": view_result(result, session, terminal)}
