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
    out: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    plan: bool = False,
    gazebo: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    release: Annotated[str, Parameter(name="--for", metavar="RELEASE")] = "harmonic",
    force: bool = False,
    workers: Annotated[int | None, Parameter(metavar="N"), count(MOST_PROCESSES)] = None,
    terminal: Shown,
) -> Figures:
    """Render what every camera would have recorded of a scene, together with the exact truth.

    Args:
        scene: Scene file; see examples/scenes and docs/simulation.md.
        out: Session folder; an unfinished one is resumed.
        plan: Render nothing: show at once what the cameras cover, and the expected error there.
        gazebo: Write the scene there as a world that Gazebo opens, with the bridge to ROS 2; see docs/gazebo.md.
        release: Release of Gazebo: fortress, harmonic or jetty.
        force: Render again even if DIR is finished.
        workers: Processes that render (default: one per core).
    """
    from posefuse.cli.simulating import show_plan, simulate_session, write_gazebo_world
    from posefuse.core import InputError

    if (out is not None) + (gazebo is not None) + plan != 1:
        raise InputError("expected --out DIR (videos), --gazebo DIR (a world) or --plan, one of them")
    if plan:
        return show_plan(scene, terminal)
    if gazebo is not None:
        return write_gazebo_world(scene, gazebo, release, force, terminal)
    assert out is not None
    return simulate_session(scene, out, force, workers, terminal)
