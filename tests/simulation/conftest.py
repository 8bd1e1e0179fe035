"""Draw one frame; skip, by name, what cannot be drawn here."""

import importlib.util
from collections.abc import Callable

import numpy as np
import pytest

from posefuse.core import DependencyError
from posefuse.core.ideal_image import optics_of
from posefuse_sim import Scene
from posefuse_sim.build import LiveScene, live_scene
from posefuse_sim.render.model import render_model
from posefuse_sim.render.shot import CameraShooter
from posefuse_sim.render.stage import RenderStage
from posefuse_sim.source import shot_image


@pytest.fixture(scope="session")
def backend() -> str:
    """A working OpenGL backend."""
    if importlib.util.find_spec("mujoco") is None:
        pytest.skip("the extra sim (mujoco) is not installed")
    from posefuse_sim.render.stage import working_backend

    try:
        return working_backend()
    except DependencyError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def shoot(backend) -> Callable[..., tuple[LiveScene, np.ndarray, np.ndarray]]:
    """Draw one frame of the first camera here: the live scene, the image (H, W, 3), what is visible (Q,)."""

    def shoot_(scene: Scene, frame: int = 0) -> tuple[LiveScene, np.ndarray, np.ndarray]:
        live = live_scene(scene)
        view = optics_of(live.rig.cameras[0]).view
        stage = RenderStage(render_model(live, (view.width, view.height), backend), backend)
        try:
            shooter = CameraShooter(live.rig.cameras[0], live.placed[0].sensor, stage)
            shot = shot_image(live, 0, frame, shooter)
            return live, shot.image, shot.visible
        finally:
            stage.close()

    return shoot_
