"""Draw a frame; skip, by name, what cannot be drawn here."""

from collections.abc import Callable

import pytest

from posefuse.core import DependencyError
from posefuse_sim import Scene
from posefuse_sim.build import LiveScene, live_scene
from posefuse_sim.render.model import render_model
from posefuse_sim.render.shot import CameraShooter, Shot, shot_image
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

    def shots_(scene: Scene, frame: int = 0) -> tuple[LiveScene, list[Shot]]:
        live = live_scene(scene)
        stage = RenderStage(render_model(live, live.rig, backend), backend)
        try:
            shooters = [CameraShooter(camera, placed.sensor, stage) for camera, placed in zip(live.rig, live.placed, strict=True)]
            return live, [shot_image(live, c, frame, shooter) for c, shooter in enumerate(shooters)]
        finally:
            stage.close()

    return shots_
