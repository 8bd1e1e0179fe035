"""A rig before it is built: `posefuse.plan`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from posefuse.evaluation.rig_plan import RigPlan
    from posefuse.simulation import Scene


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
    from posefuse.evaluation.rig_plan import plan_rig
    from posefuse.simulation.build import room_size
    from posefuse.simulation.cameras import placed_cameras, rig_from_cameras
    from posefuse.simulation.scene import read_scene
    from posefuse.simulation.surroundings import boxes_of

    chosen = read_scene(Path(scene)) if isinstance(scene, str | Path) else scene
    rig = rig_from_cameras(placed_cameras(chosen.cameras))
    return plan_rig(rig, area_m or room_size(chosen, rig), step_m=step_m, boxes=boxes_of(chosen.occluders, chosen.seed))
