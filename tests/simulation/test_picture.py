"""Are the pictures good enough? The real network looks at a simulated person from every side."""

import numpy as np
import pytest

from posefuse.core import Frame
from posefuse.core.skeleton import ANATOMICAL23, pick_keypoints
from posefuse.detection.blazepose import BlazePoseConfig
from posefuse_sim import Scene
from posefuse_sim.body import BodyShapeSettings
from posefuse_sim.build import live_scene
from posefuse_sim.cameras import ImageSettings, RingCameras
from posefuse_sim.exact import seen_points
from posefuse_sim.motion.settings import StandSettings
from posefuse_sim.render.model import render_model
from posefuse_sim.render.shot import CameraShooter
from posefuse_sim.render.stage import RenderStage
from posefuse_sim.scene import PersonSettings
from posefuse_sim.source import shot_image

_LIMBS = tuple(
    f"{side}_{joint}" for side in ("left", "right") for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
)


@pytest.fixture(scope="module")
def network(models):
    return BlazePoseConfig(streams=1).build()


@pytest.mark.gl
@pytest.mark.parametrize("sex", ["female", "male"])
def test_the_network_finds_the_person_from_every_side(sex, network, backend):
    person = PersonSettings(body=BodyShapeSettings(sex=sex), motion=StandSettings(kind="wave", heading_deg=15))
    ring = RingCameras(kind="ring", count=8, radius_m=4.0, image=ImageSettings(size_px=(640, 480)))
    live = live_scene(Scene(duration_s=0.1, cameras=ring, people=(person,)))
    stage = RenderStage(render_model(live, (640, 480), backend), backend)
    frames, truth = [], []
    for c, camera in enumerate(live.rig):
        shot = shot_image(live, c, 0, CameraShooter(camera, live.placed[c].sensor, stage))
        image, visible = shot.image, shot.visible
        frames.append(Frame(camera=camera.name, seq=0, t_ns=0, received_ns=0, image=image))
        truth.append(np.where(visible[:, None], seen_points(live, c, slice(0, 1)).xy_img[0], np.nan))
    stage.close()
    found = network.detect(frames, [None] * 8)
    assert [len(one) for one in found] == [1] * 8
    expected = pick_keypoints(np.stack(truth), ANATOMICAL23, _LIMBS)
    seen = pick_keypoints(np.stack([one.xy_img[0] for one in found]), network.skeleton, _LIMBS)
    error_px = np.linalg.norm(seen - expected, axis=-1)
    # the person is some 250 px tall: a left for a right would be off by more than 20 px
    assert np.nanmedian(error_px) < 6
    assert np.nanquantile(error_px, 0.9) < 15
