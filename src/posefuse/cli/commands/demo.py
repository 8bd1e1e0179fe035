"""`posefuse demo`: the whole pipeline on the clip that comes with the package."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from posefuse.cli.options.shared import Figures, Shown


def demo(
    *, out: Annotated[Path, Parameter(metavar="DIR")] = Path("posefuse-demo"), force: bool = False, terminal: Shown
) -> Figures:
    """Track the bundled clip of four cameras: shows within a minute whether everything works.

    Args:
        out: Folder for the result.
        force: Replace DIR if it exists.
    """
    from posefuse.cli.demo import track_demo

    return track_demo(out, force, terminal)
