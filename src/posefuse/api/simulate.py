"""Recordings with exact truth: `posefuse.simulate`."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from posefuse.core import Progress

from .progress import shown

if TYPE_CHECKING:
    from posefuse.simulation.gazebo import GazeboWorld


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
        out: new or empty folder; with `replace` an earlier session is moved to ``NAME.replaced-TIME``.
        processes: how many render at once; None: one per core.

    Returns:
        The session folder. An interrupted run of the same scene is continued.

    Raises:
        ConfigError: a scene that cannot be.
        InputError: `out` holds anything else.
        DependencyError: no OpenGL, no extra ``sim``.

    Examples:
        >>> import posefuse as pf
        >>> session = pf.simulate("examples/scenes/walk_4cam.yaml", "SESSION", progress=True)  # doctest: +SKIP
        >>> pf.track(session)  # doctest: +SKIP
    """
    from posefuse.simulation import read_scene
    from posefuse.simulation import simulate as render

    with shown(progress) as report:
        steps = lambda done, total: report("render", done, total)  # noqa: E731
        return render(read_scene(Path(scene)), Path(out), steps, processes, replace=replace).folder


def gazebo_world(scene: str | Path, out: str | Path, *, release: str = "harmonic", replace: bool = False) -> GazeboWorld:
    """Write a scene file (YAML) as a world for Gazebo, with its bridge to ROS 2 and the exact truth; needs the extra ``sim``.

    Args:
        scene: see docs/simulation.md; a person with the motion ``result`` walks as recorded.
        out: new or empty folder; with `replace` an earlier world is moved to ``NAME.replaced-TIME``.
        release: of Gazebo: ``fortress``, ``harmonic`` or ``jetty``.

    Returns:
        What was written: folder, rig, seconds until the motion starts again, and what of the scene Gazebo cannot show.

    Raises:
        ConfigError: a scene that cannot be, or not in Gazebo.
        InputError: `out` holds anything else.
        DependencyError: no extra ``sim``.

    Examples:
        >>> import posefuse as pf
        >>> world = pf.gazebo_world("examples/scenes/walk_4cam.yaml", "gz")  # doctest: +SKIP
        >>> world.folder, world.loop_s  # doctest: +SKIP
    """
    from posefuse.simulation import read_scene
    from posefuse.simulation.gazebo import export_world

    def warn(line: str) -> None:
        warnings.warn(line, UserWarning, stacklevel=2)

    return export_world(read_scene(Path(scene)), Path(out), release=release, replace_older=replace, warn=warn)
