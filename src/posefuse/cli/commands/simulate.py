"""`posefuse simulate` and `fit-noise`: scenes with exact truth, and what is fitted to them."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from posefuse.cli.command_options import FitOptions
from posefuse.cli.options import Figures, Shown, count


def simulate(
    scene: Annotated[Path, Parameter(metavar="SCENE.yaml")],
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    plan: bool = False,
    gazebo: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    release: Annotated[str, Parameter(name="--for", metavar="RELEASE")] = "harmonic",
    force: bool = False,
    workers: Annotated[int | None, Parameter(metavar="N"), count(1024)] = None,
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


def fit_noise(card: Annotated[Path, Parameter(metavar="CARD.toml")], /, *, options: FitOptions, terminal: Shown) -> Figures:
    """Fit noise and joint centres of your own network's model card on simulated people (an hour or more).

    Args:
        card: Model card; see docs/networks.md.
    """
    from posefuse.cli.fitting import fit_card

    return fit_card(card, options, terminal)
