"""The depth that simulated cameras measure: in the right place, with the noise that they state."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from posefuse.core.depth import MM_PER_M
from posefuse_sim.cameras import DepthSettings, ImageSettings, ListedCameras, PlacedCamera, SensorSettings
from posefuse_sim.props import CharucoBoard, StillPath
from posefuse_sim.render.shot import measured_depth, noise_of
from posefuse_sim.scene import Scene

EXACT = DepthSettings(disparity_sigma_px=0, step_px=0, floor_m=0, lateral_px=0, edge_loss=0)


@pytest.mark.parametrize("depth_m", [1.0, 2.5, 4.0])
def test_noise_is_as_large_as_stated_and_alike_within_a_block(depth_m: float) -> None:
    settings = DepthSettings(lateral_px=0.0)
    image = measured_depth(np.full((240, 320), depth_m, np.float32), settings, [1])
    error_m = image.values / MM_PER_M - depth_m
    noise = noise_of(settings)
    # a step of the disparity adds the spread of one step
    step_m = depth_m**2 / (noise.focal_px * noise.baseline_m) * noise.step_px
    stated = np.hypot(float(noise.sigma_m(np.array(depth_m))), step_m / np.sqrt(12))
    assert error_m.std() == pytest.approx(stated, rel=0.05)
    assert abs(error_m.mean()) < 0.1 * stated
    if depth_m > 2:
        beside = np.corrcoef(error_m[:, :-1].ravel(), error_m[:, 1:].ravel())[0, 1]
        apart = np.corrcoef(error_m[:, :-20].ravel(), error_m[:, 20:].ravel())[0, 1]
        assert beside > 0.7
        assert abs(apart) < 0.1


def test_a_disparity_has_steps() -> None:
    settings = replace(EXACT, step_px=1 / 8)
    ramp = np.tile(np.linspace(3, 4, 320, dtype=np.float32), (4, 1))
    values = measured_depth(ramp, settings, [1]).values
    disparity = settings.focal_px * settings.baseline_m / (values / MM_PER_M)
    assert np.abs(disparity * 8 - np.rint(disparity * 8)).max() < 0.03
    assert len(np.unique(values)) < 20


def test_edges_lose_pixels_and_are_ragged_and_the_far_is_unknown() -> None:
    true_m = np.full((200, 200), 3.0, np.float32)
    true_m[:, :100] = 1.5
    true_m[:20] = 30.0
    plain = measured_depth(true_m, EXACT, [1]).values
    np.testing.assert_array_equal(plain[20:], np.where(true_m[20:] == 1.5, 1500, 3000))
    assert (plain[:20] == 0).all()
    torn = measured_depth(true_m, replace(EXACT, lateral_px=0.8, edge_loss=0.5), [1]).values[40:]
    assert 0.3 < (torn[:, 98:102] == 0).mean() < 0.7
    assert (torn[:, 110:] == 3000).all()
    column = torn[:, 99]
    assert 0.05 < (column[column > 0] == 3000).mean() < 0.5


@pytest.mark.gl
@pytest.mark.parametrize("distortion", [(), (-0.28, 0.09, 0.002, -0.003, -0.01)], ids=["ideal", "bent"])
def test_depth_lies_under_the_projected_pixels(distortion: tuple[float, ...], shots: Callable) -> None:
    image = ImageSettings(size_px=(320, 240), distortion=distortion)
    camera = PlacedCamera(
        name="eye", position_m=(1.1, -1.4, 1.9), look_at_m=(0.1, 0.1, 1.0), roll_deg=25, image=image,
        sensor=SensorSettings(depth=EXACT),
    )  # fmt: skip
    path = StillPath(kind="still", position_m=(0.0, 0.0, 1.0), yaw_deg=30, pitch_deg=8, roll_deg=55)
    board = CharucoBoard(kind="charuco_board", square_m=0.13, marker_m=0.06, path=path)
    live, [shot] = shots(Scene(duration_s=0.2, cameras=ListedCameras(kind="list", cameras=(camera,)), props=(board,)))
    eye = live.rig.cameras[0]
    chess = live.prop_poses(np.zeros(1))[0][0] @ live.props[0].chess_prop
    assert shot.depth is not None
    column, row = np.rint(eye.project(chess)).astype(int).T
    found_m = shot.depth.values[row, column] * shot.depth.unit_m
    # half a pixel on a slanted board, and millimetres
    np.testing.assert_allclose(found_m, (eye.cam_from_world @ chess)[:, 2], atol=0.006)
