"""Scenes: rendered with their exact truth, written for Gazebo, or planned before anything is built."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from posefuse.api.arguments import shown
from posefuse.core import Progress
from posefuse.core.errors import warn_caller

if TYPE_CHECKING:
    from posefuse_sim import Scene
    from posefuse_sim.gazebo import GazeboWorld
    from posefuse_sim.rig_plan import RigPlan


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
    from posefuse.foundation.output_file import check_outside_inputs
    from posefuse.foundation.output_folder import find_unfinished
    from posefuse_sim import read_scene
    from posefuse_sim import simulate as render

    chosen, place = read_scene(Path(scene)), Path(out)
    check_outside_inputs(place, (Path(scene),))
    try:
        with shown(progress) as report:
            steps = lambda done, total: report("rendering", done, total)  # noqa: E731
            return render(chosen, place, steps, processes, replace=replace).folder
    except KeyboardInterrupt:
        if find_unfinished(place):
            line = f"{place}: what was rendered is kept; the same command continues where it stopped"
            warn_caller(line)
        raise


def gazebo_world(scene: str | Path, out: str | Path, *, replace: bool = False) -> GazeboWorld:
    """Write a scene file (YAML) as a world for Gazebo, with its bridge to ROS 2 and the exact truth; needs the extra ``sim``.

    Args:
        scene: see docs/simulation.md; a person with the motion ``result`` walks as recorded.
        out: new or empty folder; with `replace` an earlier world is moved to ``NAME.replaced-TIME``.

    Returns:
        What was written: folder, rig, seconds until the motion starts again.

    Raises:
        ConfigError: a scene that cannot be, or not in Gazebo.
        InputError: `out` holds anything else.
        DependencyError: no extra ``sim``.

    Examples:
        >>> import posefuse as pf
        >>> world = pf.gazebo_world("examples/scenes/walk_4cam.yaml", "gz")  # doctest: +SKIP
        >>> world.folder, world.loop_s  # doctest: +SKIP
    """
    from posefuse.foundation.output_file import check_outside_inputs
    from posefuse_sim import read_scene
    from posefuse_sim.gazebo import export_world

    chosen = read_scene(Path(scene))
    check_outside_inputs(Path(out), (Path(scene),))
    return export_world(chosen, Path(out), replace_older=replace)


def plan(scene: Scene | str | Path, *, area_m: tuple[float, float] | None = None, step_m: float = 0.1) -> RigPlan:
    """What the cameras of a scene cover, and the expected error there; nothing is rendered.

    The error is that of one keypoint in one time step from the noise of a detector: occlusion by people, calibration and the
    detector's own bias come on top, smoothing over time takes away.

    Args:
        scene: a scene file (YAML or TOML, see docs/simulation.md), or its settings; cameras, room and occluders are used.
        area_m: (x, y) of the floor about the origin to look at; None: the whole room.
        step_m: distance between points on the floor.

    Returns:
        Maps of views and error over the floor and heights from ankle to head.

    Raises:
        ConfigError: a scene that cannot be. InputError: more points than can be computed at once.

    Examples:
        >>> import posefuse as pf
        >>> found = pf.plan("examples/scenes/walk_4cam.yaml", area_m=(2.0, 2.0))
        >>> bool(found.covered() > 0.9 and 0 < found.error_at(0.5) < 50)
        True
    """
    from posefuse_sim.build import room_size
    from posefuse_sim.rig_plan import plan_rig, rig_of_scene
    from posefuse_sim.scene import read_scene
    from posefuse_sim.surroundings import boxes_of

    chosen = read_scene(Path(scene)) if isinstance(scene, str | Path) else scene
    rig = rig_of_scene(chosen)
    return plan_rig(rig, area_m or room_size(chosen, rig), step_m=step_m, boxes=boxes_of(chosen.occluders, chosen.seed))
