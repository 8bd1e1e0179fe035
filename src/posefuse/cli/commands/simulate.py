"""`posefuse simulate`: a scene file to a session with exact truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from posefuse.cli.options.shared import Figures, Shown, count

MOST_PROCESSES = 1024


def simulate(
    scene: Annotated[Path, Parameter(metavar="SCENE.yaml")],
    /,
    *,
    out: Annotated[Path, Parameter(metavar="DIR")],
    force: bool = False,
    workers: Annotated[int | None, Parameter(metavar="N"), count(MOST_PROCESSES)] = None,
    terminal: Shown,
) -> Figures:
    """Render what every camera would have recorded of a scene, together with the exact truth.

    Args:
        scene: Scene file; see examples/scenes and docs/simulation.md.
        out: Session folder; an unfinished one is resumed.
        force: Render anew even if DIR is finished.
        workers: Processes that render (default: one per core).
    """
    from posefuse.cli.simulating import simulate_session

    return simulate_session(scene, out, force, workers, terminal)
