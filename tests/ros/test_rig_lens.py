"""Ideal images of a simulator get the lens of the rig's camera."""

from dataclasses import replace

import numpy as np
import pytest
from checks import refusal

from posefuse.core import SE3, Camera, MessageError, SourceError
from posefuse.core.ideal_image import drawn_camera
from posefuse_ros.camera_info import RigLens, camera_of_info, is_ideal_image_of
from posefuse_ros.camera_messages import info_from_camera

BENT = Camera(
    name="cam",
    size_wh=(240, 180),
    K=np.array([[210.0, 0, 118], [0, 205, 92], [0, 0, 1]]),
    cam_from_world=SE3.identity(),
    distortion=np.array([-0.25, 0.08, 0.002, -0.001, 0.0]),
)


def _picture(camera: Camera) -> np.ndarray:
    """What a camera sees of a smooth pattern at infinity: red and green are x/z and y/z."""
    columns, rows = np.meshgrid(np.arange(camera.size_wh[0]), np.arange(camera.size_wh[1]))
    norm = camera.norm_from_px(np.stack([columns, rows], axis=-1))
    return np.concatenate([128 + 100 * norm, np.zeros((*norm.shape[:2], 1))], axis=-1)


def test_an_ideal_image_becomes_the_cameras_own():
    lens, drawn = RigLens(BENT), drawn_camera(BENT)
    assert drawn.size_wh != BENT.size_wh and lens.ideal_wh == drawn.size_wh
    taken_in = lens(_picture(drawn).astype(np.float32))
    # a grey level of 100 per unit of x/z, some 210 px: a fifth of a pixel is 0.1
    assert np.abs(taken_in - _picture(BENT)).max() < 0.05


def test_an_image_of_the_cameras_size_stays_and_any_other_is_refused():
    lens = RigLens(BENT)
    image = np.zeros((180, 240, 3), np.uint8)
    assert lens(image) is image
    with pytest.raises(SourceError, match=r"expected images of 240x180 px, or \d+x\d+ of an ideal camera, got 100x50"):
        lens(np.zeros((50, 100, 3), np.uint8))


def test_the_camera_info_of_a_simulator_confirms_the_rig():
    drawn = drawn_camera(BENT)
    # pixels counted from the edge of the image
    stated = replace(drawn, K=drawn.K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]))
    assert is_ideal_image_of(BENT, stated)
    assert camera_of_info(BENT, info_from_camera(stated, 0)) is BENT
    other = replace(stated, K=stated.K * np.array([[1.01, 1, 1], [1, 1.01, 1], [1, 1, 1]]))
    assert not is_ideal_image_of(BENT, other)
    refusal(MessageError, "images are", lambda: camera_of_info(BENT, info_from_camera(other, 0)))


@pytest.mark.parametrize(
    "camera",
    [
        BENT,
        replace(BENT, distortion=np.array([0.15, -0.02, 0.0, 0.001])),
        replace(BENT, distortion=np.zeros(0), K=BENT.K + np.array([[0, 2.0, 0], [0, 0, 0], [0, 0, 0]])),
        replace(BENT, distortion=np.array([0.02, -0.01, 0.001, 0.0]), model="fisheye"),
    ],
    ids=["barrel", "pincushion", "skew", "fisheye"],
)
def test_the_ideal_camera_sees_all_that_the_lens_sees(camera):
    drawn = drawn_camera(camera)
    corners = np.array([[0, 0], [camera.size_wh[0] - 1, 0], [0, camera.size_wh[1] - 1], np.array(camera.size_wh) - 1], float)
    seen = drawn.px_from_norm(camera.norm_from_px(corners))
    assert (seen > 0).all() and (seen < np.array(drawn.size_wh) - 1).all()
