"""The rendered picture against `Camera.project`: the pixel convention, the lens, the pose, to parts of a pixel."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from calibrating import refined
from checks import refusal
from scenes import PLAIN_ROOM, chess_corners, listed, marker_corners, scene, still

from posefuse.core import ConfigError
from posefuse.core.depth import MM_PER_M
from posefuse.core.ideal_image import optics_of
from posefuse_sim.build import live_scene
from posefuse_sim.cameras import DepthSettings
from posefuse_sim.props import GroundTile
from posefuse_sim.render.shot import measured_depth, noise_of
from posefuse_sim.scene import Scene

EXACT_DEPTH = {"disparity_sigma_px": 0, "step_px": 0, "floor_m": 0, "lateral_px": 0, "edge_loss": 0}
_FISHEYE = {"lens": "fisheye", "distortion": [0.02, -0.01, 0.001, 0.0], "K": [[330.0, 0, 352.0], [0, 332.0, 275.0], [0, 0, 1]]}
LENSES = {
    "ideal": {},
    "bent": {"distortion": [-0.28, 0.09, 0.002, -0.003, -0.01]},
    "pincushion": {"size_px": [800, 450], "distortion": [0.15, -0.02, 0.0, 0.001]},
    "odd K": {"size_px": [643, 361], "K": [[560.0, 0, 300.3], [0, 610.0, 170.8], [0, 0, 1]]},
    "fisheye": {"size_px": [720, 540], **_FISHEYE},
}
_PATH = still([0.0, 0.0, 1.0], yaw_deg=30, pitch_deg=8, roll_deg=55)
_BOARD = {"kind": "charuco_board", "square_m": 0.13, "marker_m": 0.06, "path": _PATH}
_CUBE = {"kind": "aruco_cube", "side_m": 0.5, "marker_m": 0.36, "path": still([0.1, 0, 0.6], yaw_deg=-8)}
_TILE = {"kind": "ground_tile", "path": still([0, 0, 0.8])}


def _scene(image: dict, prop: dict = _BOARD, **sensor) -> Scene:
    place = {"position_m": [1.1, -1.4, 1.9], "look_at_m": [0.1, 0.1, 1.0], "roll_deg": 25}
    camera = {"name": "eye", **place, "image": image, "sensor": sensor}
    return scene(duration_s=0.2, cameras=listed(camera), props=[prop], room=PLAIN_ROOM)


@pytest.mark.gl
@pytest.mark.parametrize("lens", LENSES)
def test_chessboard_corners_are_at_their_projections(lens, shots):
    live, [shot] = shots(_scene(LENSES[lens]))
    expected = live.rig.cameras[0].project(live.prop_poses(np.zeros(1))[0][0] @ chess_corners(live.scene.props[0]))
    error = refined(shot.image, expected, 3) - expected
    # a shift of half a pixel, or a lens that bends the wrong way, is far outside this
    assert np.abs(error).max() < 0.2
    assert np.linalg.norm(error.mean(axis=0)) < 0.05


@pytest.mark.gl
@pytest.mark.parametrize("lens", ["ideal", "bent"])
def test_measured_depth_lies_under_the_projected_pixels(lens, shots):
    live, [shot] = shots(_scene(LENSES[lens], depth=EXACT_DEPTH))
    eye, chess = live.rig.cameras[0], live.prop_poses(np.zeros(1))[0][0] @ chess_corners(live.scene.props[0])
    column, row = np.rint(eye.project(chess)).astype(int).T
    found_m = shot.depth.values[row, column] * shot.depth.unit_m
    # half a pixel on a slanted board, and millimetres
    np.testing.assert_allclose(found_m, (eye.cam_from_world @ chess)[:, 2], atol=0.006)


@pytest.mark.gl
@pytest.mark.parametrize("prop", [_CUBE, _TILE], ids=["cube", "tile"])
def test_markers_are_found_by_opencv_with_their_ids_and_corner_order(prop, shots):
    live, [shot] = shots(_scene(LENSES["bent"], prop))
    made, camera = live.scene.props[0], live.rig.cameras[0]
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, made.dictionary))
    search = cv2.aruco.DetectorParameters()
    search.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, search).detectMarkers(cv2.cvtColor(shot.image, cv2.COLOR_RGB2GRAY))
    expected = camera.project(live.prop_poses(np.zeros(1))[0][0] @ marker_corners(made))
    # what is seen from its front is clockwise in the image; nothing stands before the prop
    along, down = expected[:, 1] - expected[:, 0], expected[:, 3] - expected[:, 0]
    shown = along[:, 0] * down[:, 1] > along[:, 1] * down[:, 0]
    first = made.id if isinstance(made, GroundTile) else made.first_id
    assert set(ids.ravel()) == set(first + np.flatnonzero(shown))
    for found, marker in zip(corners, ids.ravel(), strict=True):
        assert np.abs(found[0] - expected[marker - first]).max() < 0.5


def test_a_lens_that_sees_behind_the_image_plane_is_refused_by_name():
    wide = {"size_px": [800, 800], **_FISHEYE, "K": [[220.0, 0, 400.0], [0, 220.0, 400.0], [0, 0, 1]], "distortion": [0] * 4}
    live = live_scene(_scene(wide, {"kind": "ground_tile"}))
    refusal(ConfigError, r"camera eye: its lens sees .* longer focal length", optics_of, live.rig.cameras[0])


# --- the depth that simulated cameras measure: in the right place, with the noise that they state


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
        adjacent = np.corrcoef(error_m[:, :-1].ravel(), error_m[:, 1:].ravel())[0, 1]
        apart = np.corrcoef(error_m[:, :-20].ravel(), error_m[:, 20:].ravel())[0, 1]
        assert adjacent > 0.7
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
