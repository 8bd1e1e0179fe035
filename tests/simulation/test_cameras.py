"""Where cameras stand and look."""

import numpy as np
import pytest

from posefuse.core import ConfigError
from posefuse_sim.cameras import (
    CameraOverride,
    ImageSettings,
    ListedCameras,
    PlacedCamera,
    RingCameras,
    SensorSettings,
    placed_cameras,
    rig_from_cameras,
)


def _rig(settings):
    return rig_from_cameras(placed_cameras(settings))


def test_a_ring_looks_at_its_point_from_its_circle():
    rig = _rig(RingCameras(kind="ring", count=5, radius_m=3.0, height_m=1.7, centre_m=(0.5, -1.0), look_at_m=(0.2, 0.1, 0.9)))
    centres = rig.centres_world()
    np.testing.assert_allclose(np.hypot(centres[:, 0] - 0.5, centres[:, 1] + 1.0), 3.0)
    np.testing.assert_allclose(centres[:, 2], 1.7)
    middle = np.tile([(640 - 1) / 2, (480 - 1) / 2], (5, 1))
    np.testing.assert_allclose(rig.project(np.array([0.2, 0.1, 0.9])), middle, atol=1e-9)


def test_up_is_up_in_every_picture():
    rig = _rig(RingCameras(kind="ring"))
    low, high = rig.project(np.array([0, 0, 0.5])), rig.project(np.array([0, 0, 1.5]))
    assert (high[:, 1] < low[:, 1] - 50).all()
    np.testing.assert_allclose(high[:, 0], low[:, 0], atol=1e-9)


def test_the_field_of_view_is_between_the_edges():
    camera = _rig(RingCameras(kind="ring", count=1, image=ImageSettings(size_px=(800, 600), horizontal_fov_deg=70.0))).cameras[0]
    left, right = camera.norm_from_px(np.array([[-0.5, 299.5], [799.5, 299.5]]))[:, 0]
    assert np.rad2deg(np.arctan(right) - np.arctan(left)) == pytest.approx(70.0)


def test_roll_turns_the_camera_clockwise_so_the_world_turns_the_other_way():
    camera = PlacedCamera(name="a", position_m=(0.0, -3.0, 1.0), look_at_m=(0.0, 0.0, 1.0), roll_deg=90.0)
    above = _rig(ListedCameras(kind="list", cameras=(camera,))).project(np.array([0.0, 0.0, 1.5]))[0]
    # turned clockwise by a quarter, what was up is now on the left
    assert above[0] < 300 and above[1] == pytest.approx(239.5)


def test_a_camera_may_look_straight_down():
    camera = PlacedCamera(name="a", position_m=(0.0, 0.0, 3.0), look_at_m=(0.0, 0.0, 0.0))
    rig = _rig(ListedCameras(kind="list", cameras=(camera,)))
    north = rig.project(np.array([0.0, 0.5, 0.0]))[0]
    assert north[1] < 239 and north[0] == pytest.approx(319.5)


def test_overrides_change_one_camera_only():
    own = CameraOverride(image=ImageSettings(size_px=(320, 200)), sensor=SensorSettings(readout_s=0.01))
    rig = _rig(RingCameras(kind="ring", count=3, overrides={"cam01": own}))
    assert [camera.size_wh for camera in rig] == [(640, 480), (320, 200), (640, 480)]
    assert [camera.readout_s for camera in rig] == [0.0, 0.01, 0.0]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            RingCameras(kind="ring", overrides={"cam9": CameraOverride()}),
            "no camera 'cam9'; there are: cam00, cam01, cam02, cam03",
        ),
        (RingCameras(kind="ring", count=1, image=ImageSettings(distortion=(0.1,))), r"camera cam00: distortion.*got 1"),
        (
            RingCameras(kind="ring", count=1, image=ImageSettings(K=((-5.0, 0, 1), (0, 5.0, 1), (0, 0, 1)))),
            "camera cam00: K: expected",
        ),
        (
            ListedCameras(kind="list", cameras=(PlacedCamera(name="a", position_m=(0, 0, 1.0), look_at_m=(0, 0, 1.0)),)),
            "camera a: look_at_m is its own position",
        ),
        (RingCameras(kind="ring", count=2, radius_m=1e308), "camera cam00: expected a position within 1e.06 m of look_at_m"),
    ],
)
def test_impossible_cameras_are_refused(settings, message):
    with pytest.raises(ConfigError, match=message):
        _rig(settings)
