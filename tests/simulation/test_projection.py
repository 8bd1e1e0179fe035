"""The rendered picture against `Camera.project`: the pixel convention, the lens, the pose, to parts of a pixel."""

import cv2
import numpy as np
import pytest
from calibrating import refined
from checks import refusal
from scenes import PLAIN_ROOM, listed, scene, still

from posefuse.core import ConfigError
from posefuse.core.ideal_image import optics_of
from posefuse_sim.build import live_scene
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
    prop, camera = live.props[0], live.rig.cameras[0]
    chess = live.prop_poses(np.zeros(1))[0][0] @ prop.chess_prop
    expected = camera.project(chess)
    assert shot.visible[-len(chess) :].all()
    error = refined(shot.image, expected, 3) - expected
    # a shift of half a pixel, or a lens that bends the wrong way, is far outside this
    assert np.abs(error).max() < 0.2
    assert np.linalg.norm(error.mean(axis=0)) < 0.05


@pytest.mark.gl
@pytest.mark.parametrize("lens", ["ideal", "bent"])
def test_measured_depth_lies_under_the_projected_pixels(lens, shots):
    live, [shot] = shots(_scene(LENSES[lens], depth=EXACT_DEPTH))
    eye, chess = live.rig.cameras[0], live.prop_poses(np.zeros(1))[0][0] @ live.props[0].chess_prop
    column, row = np.rint(eye.project(chess)).astype(int).T
    found_m = shot.depth.values[row, column] * shot.depth.unit_m
    # half a pixel on a slanted board, and millimetres
    np.testing.assert_allclose(found_m, (eye.cam_from_world @ chess)[:, 2], atol=0.006)


@pytest.mark.gl
@pytest.mark.parametrize("prop", [_CUBE, _TILE], ids=["cube", "tile"])
def test_markers_are_found_by_opencv_with_their_ids_and_corner_order(prop, shots):
    live, [shot] = shots(_scene(LENSES["bent"], prop))
    made, camera = live.props[0], live.rig.cameras[0]
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, made.dictionary))
    search = cv2.aruco.DetectorParameters()
    search.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary, search).detectMarkers(cv2.cvtColor(shot.image, cv2.COLOR_RGB2GRAY))
    expected = camera.project(live.prop_poses(np.zeros(1))[0][0] @ made.points_prop).reshape(-1, 4, 2)
    shown = shot.visible.reshape(-1, 4).all(axis=1)
    assert set(ids.ravel()) == set(made.marker_id[shown])
    for found, marker in zip(corners, ids.ravel(), strict=True):
        assert np.abs(found[0] - expected[list(made.marker_id).index(marker)]).max() < 0.5


def test_a_lens_that_sees_behind_the_image_plane_is_refused_by_name():
    wide = {"size_px": [800, 800], **_FISHEYE, "K": [[220.0, 0, 400.0], [0, 220.0, 400.0], [0, 0, 1]], "distortion": [0] * 4}
    live = live_scene(_scene(wide, {"kind": "ground_tile"}))
    refusal(ConfigError, r"camera eye: its lens sees .* longer focal length", optics_of, live.rig.cameras[0])
