"""Our renderer, driven by the cameras that libsdformat reads from the world, draws the pictures of the scene."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from gazebo_camera import camera_from_gazebo

from posefuse.core.ideal_image import drawn_camera, optics_of
from posefuse_ros.camera_info import RigLens
from posefuse_sim.cameras import SensorSettings
from posefuse_sim.render.model import render_model
from posefuse_sim.render.shot import CameraShooter
from posefuse_sim.render.stage import RenderStage
from posefuse_sim.session import body_poses


@pytest.fixture(scope="module")
def draw(written, backend):
    live = written.live
    sizes = [optics_of(camera).view for camera in live.rig]
    stage = RenderStage(render_model(live, (max(v.width for v in sizes), max(v.height for v in sizes)), backend), backend)

    def draw_(camera, t_s=0.4):
        poses = body_poses(live, np.array([t_s]))
        shooter = CameraShooter(camera, SensorSettings(), stage)
        return shooter.shoot(poses, np.zeros((0, 3)), np.zeros(0, bool), np.zeros(0), [0]).image

    yield draw_
    stage.close()


@pytest.fixture(scope="module")
def read_cameras(written, libsdformat):
    return {one["name"]: camera_from_gazebo(one) for one in libsdformat(written.sdf)["cameras"]}


def _shift_px(one, other):
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) for image in (one, other)]
    return np.abs(cv2.phaseCorrelate(*grey, cv2.createHanningWindow(grey[0].shape[::-1], cv2.CV_32F))[0]).max()


@pytest.mark.gl
@pytest.mark.parametrize("name", ["plain", "above"])
def test_cameras_read_from_the_world_draw_the_same_picture(name, written, draw, read_cameras):
    ours, theirs = draw(written.live.rig[name]), draw(read_cameras[name])
    assert np.abs(ours.astype(int) - theirs).mean() < 0.05 and _shift_px(ours, theirs) < 0.01
    # half a pixel, as much as the two conventions differ by, would be seen
    K = read_cameras[name].K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    moved = draw(replace(read_cameras[name], K=K))
    assert np.abs(ours.astype(int) - moved).mean() > 0.5 and _shift_px(ours, moved) > 0.3


@pytest.mark.gl
def test_the_lens_at_intake_makes_our_picture_of_an_ideal_one(written, draw, read_cameras):
    camera, ideal = written.live.rig["bent"], draw(read_cameras["bent"])
    assert ideal.shape[:2][::-1] == drawn_camera(camera).size_wh != camera.size_wh
    ours, taken_in = draw(camera), RigLens(camera)(ideal)
    assert taken_in.shape == ours.shape
    assert np.abs(ours.astype(int) - taken_in).mean() < 0.3 and _shift_px(ours, taken_in) < 0.05
    # and where the board is seen, its corners are where the rig's lens puts them
    expected = _corners(written, camera)
    grey = cv2.cvtColor(taken_in, cv2.COLOR_RGB2GRAY)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-3)
    found = cv2.cornerSubPix(grey, expected.astype(np.float32).reshape(-1, 1, 2).copy(), (2, 2), (-1, -1), stop)[:, 0]
    assert np.linalg.norm((found - expected).mean(axis=0)) < 0.2


def _corners(written, camera):
    prop = next(one for one in written.live.props if one.kind == "charuco_board")
    place = written.live.props.index(prop)
    return camera.project(written.live.prop_poses(np.zeros(1))[place][0] @ prop.chess_prop)
