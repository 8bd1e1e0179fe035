"""Recordings with exact truth: `posefuse.simulate`."""

from __future__ import annotations

from pathlib import Path

from posefuse.core import Progress

from .progress import shown


def simulate(
    scene: str | Path,
    out: str | Path,
    *,
    replace: bool = False,
    processes: int | None = None,
    progress: Progress | bool | None = None,
) -> Path:
    """Render a scene file (YAML) into a session folder with its exact truth, which `track` takes; needs the extra ``sim``.

    Args:
        scene: see docs/simulation.md.
        out: new or empty folder; with `replace` also an unchanged session that posefuse wrote.
        processes: how many render at once; None: one per core.

    Returns:
        The session folder. An interrupted run of the same scene is continued.

    Raises:
        ConfigError: a scene that cannot be.
        InputError: `out` holds anything else.
        DependencyError: no OpenGL, no extra ``sim``.
    """
    from posefuse.simulation import read_scene
    from posefuse.simulation import simulate as render

    with shown(progress) as report:
        steps = lambda done, total: report("render", done, total)  # noqa: E731
        return render(read_scene(Path(scene)), Path(out), steps, processes, replace=replace).folder
