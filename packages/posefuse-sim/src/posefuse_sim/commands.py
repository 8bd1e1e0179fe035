"""`posefuse simulate` and `fit-noise`: scenes with exact truth, and what is fitted to them."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

import posefuse as pf
from posefuse.cli.options import Figures, Shown, check_used, count
from posefuse.cli.terminal import quoted


def simulate(
    scene: Annotated[Path, Parameter(metavar="SCENE.yaml")],
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    plan: bool = False,
    gazebo: Annotated[Path | None, Parameter(metavar="DIR")] = None,
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
        force: Render again even if DIR is finished.
        workers: Processes that render (default: one per core).
    """
    from posefuse.core import InputError
    from posefuse.foundation.summary import Facts, Heading

    if (out is not None) + (gazebo is not None) + plan != 1:
        raise InputError("expected --out DIR (videos), --gazebo DIR (a world) or --plan, one of them")
    check_used(
        [
            (f"--workers {workers}", workers is not None, out, "goes with --out DIR only"),
            ("--force", force, not plan, "goes with --out DIR or --gazebo DIR only"),
        ]
    )
    if plan:
        found = pf.plan(scene)
        terminal.show(found.summary())
        terminal.next(f"posefuse simulate {quoted(scene)} --out DIR", "a test walk, rendered, with its exact truth")
        return found.figures
    if gazebo is not None:
        world = pf.gazebo_world(scene, gazebo, replace=force)
        terminal.show(world.summary())
        terminal.next(quoted(world.folder / "launch.sh"), "Gazebo and the bridge to ROS 2; docs/gazebo.md continues from there")
        return world.figures
    assert out is not None
    began_s = time.perf_counter()
    with terminal.stages() as progress:
        folder = pf.simulate(scene, out, replace=force, processes=workers, progress=progress)
    figures = _figures(folder, time.perf_counter() - began_s)
    facts = {
        "cameras": ", ".join(figures["cameras"]),
        "people": figures["people"],
        "frames": figures["frames"],
        "rendered in": f"{figures['seconds']:.1f} s",
        "session": str(folder),
    }
    terminal.show([Heading("Simulated"), Facts(facts)])
    result = quoted(f"{folder.name}-result")
    terminal.next(f"posefuse track {quoted(folder)} --out {result}", "the 3D skeleton, compared with the truth")
    return figures


def _figures(folder: Path, seconds: float) -> dict[str, Any]:
    """Of a session that was rendered in so many seconds."""
    from posefuse.formats.truth import read_truth
    from posefuse_sim.session import SessionPaths

    truth = read_truth(SessionPaths(folder).truth)
    return {
        "cameras": list(truth.rig.names),
        "people": len(truth.person_id),
        "frames": sum(len(view.t_ns) for view in truth.views),
        "seconds": seconds,
        "out": folder,
    }


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """The scenes, and what runs the network.

    Attributes:
        scenes_in: Folder for the rendered scenes; later fits use them again.
        scenes: Scenes for the noise.
        moving: Scenes for the joint centres; at most 16.
        device: Processor, e.g. cpu or cuda:1; auto is a graphics card of NVIDIA if one runs the network.
    """

    scenes_in: Annotated[Path, Parameter(metavar="DIR")]
    scenes: Annotated[int, Parameter(metavar="N"), count(100)] = 24
    moving: Annotated[int, Parameter(metavar="N"), count(100)] = 16
    device: str = "auto"


def fit_noise(card: Annotated[Path, Parameter(metavar="CARD.toml")], /, *, options: FitOptions, terminal: Shown) -> Figures:
    """Fit noise and joint centres of your own network's model card on simulated people (an hour or more).

    Args:
        card: Model card; see docs/networks.md.
    """
    from posefuse_sim.fitting import fit_card

    with terminal.stages() as progress:
        made = fit_card(
            card, options.scenes_in, scenes=options.scenes, moving=options.moving, device=options.device, progress=progress
        )
    terminal.show(made.summary())
    add = [f'noise = "{made.noise_file.name}"']
    add += [f'joint_centres = "{made.joint_centres_file.name}"'] if made.joint_centres_file else []
    terminal.next(f"add to {card}: {'; '.join(add)}", "the fits are used from then on")
    return made.figures
