"""Draw a frame; skip, by name, what cannot be drawn here."""

from collections.abc import Callable

import pytest

from posefuse.core import DependencyError
from posefuse_sim import Scene
from posefuse_sim.build import LiveScene, live_scene
from posefuse_sim.exact import flesh_of_points
from posefuse_sim.render.model import render_model
from posefuse_sim.render.shot import CameraShooter, Shot, exposed, noise_seed
from posefuse_sim.render.stage import RenderStage, working_backend


@pytest.fixture(scope="session")
def backend() -> str:
    """A working OpenGL backend."""
    try:
        return working_backend()
    except DependencyError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def shots(backend) -> Callable[..., tuple[LiveScene, list[Shot]]]:
    """Draw one frame of every camera here: the live scene, and what each camera took."""

    def shot(live: LiveScene, c: int, frame: int, stage: RenderStage) -> Shot:
        poses, seen = exposed(live, c, slice(frame, frame + 1))
        shooter = CameraShooter(live.rig.cameras[c], live.placed[c].sensor, stage)
        return shooter.shoot(poses[0], seen.xyz_world[0], seen.possible[0], flesh_of_points(live), noise_seed(live, c, frame))

    def shots_(scene: Scene, frame: int = 0) -> tuple[LiveScene, list[Shot]]:
        live = live_scene(scene)
        stage = RenderStage(render_model(live, live.rig, backend), backend)
        try:
            return live, [shot(live, c, frame, stage) for c in range(len(live.rig))]
        finally:
            stage.close()

    return shots_
