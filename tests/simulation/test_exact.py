"""The truth about 2D: exact pixels triangulate back to the exact points, rolling shutters included."""

import numpy as np
import pytest
from built import standing
from scenes import listed, marker_corners, scene

from posefuse.core import SE3, Rig
from posefuse.core.skeleton import ANATOMICAL23
from posefuse_sim.build import LiveScene, live_scene
from posefuse_sim.exact import seen_points, truth_of
from posefuse_sim.props import ArucoCube, CharucoBoard, GroundTile, Prop, prop_from_settings
from posefuse_sim.surroundings import FLESH_M, Box, ClutterOccluder, WallOccluder, boxes_of, hidden_by_shapes

_FISHEYE = {"lens": "fisheye", "distortion": [0.03, -0.01, 0.002, 0.0], "K": [[420.0, 0, 450.0], [0, 421.0, 449.0], [0, 0, 1]]}
_CAMERAS = (
    {"name": "tilted", "position_m": [3.2, 0.4, 2.5], "roll_deg": 37, "image": {"size_px": [1280, 720]}},
    {"name": "bent", "position_m": [-1.5, 3.1, 0.4], "image": {"distortion": [-0.31, 0.12, 0.003, -0.002, -0.02]}},
    {"name": "fish", "position_m": [-2.8, -1.9, 1.7], "roll_deg": -90, "image": {"size_px": [900, 901], **_FISHEYE}},
    {"name": "small", "position_m": [1.0, -3.5, 2.0], "image": {"size_px": [320, 200]}},
)
_WAVES = {"motion": {"kind": "wave", "period_s": 0.5}}


def _live(**sensor) -> LiveScene:
    cameras = listed(*({**camera, "sensor": sensor} for camera in _CAMERAS))
    return live_scene(scene(duration_s=2, rate_hz=10, cameras=cameras, people=[_WAVES]))


def _triangulated(rig: Rig, xy_img: np.ndarray) -> np.ndarray:
    """(F, Q, 3) linear least squares over the views (C, F, Q, 2), by hand."""
    norm = np.stack([camera.norm_from_px(xy) for camera, xy in zip(rig, xy_img, strict=True)])
    poses = np.stack([camera.cam_from_world.matrix4()[:3] for camera in rig])
    rows = norm[..., None] * poses[:, None, None, None, 2] - poses[:, None, None, :2]
    a = np.moveaxis(rows, 0, 2).reshape(*norm.shape[1:3], -1, 4)
    flat = [np.linalg.lstsq(m[:, :3], -m[:, 3], rcond=None)[0] for m in a.reshape(-1, *a.shape[2:])]
    return np.reshape(flat, (*norm.shape[1:3], 3))


def test_exact_pixels_triangulate_to_the_exact_points():
    live = _live()
    seen = [seen_points(live, c, slice(0, 20)) for c in range(4)]
    xyz = _triangulated(live.rig, np.stack([one.xy_img for one in seen]))
    assert np.linalg.norm(xyz - seen[0].xyz_world, axis=-1).max() < 1e-7


def test_a_rolling_shutter_is_seen_by_every_point_at_its_own_row():
    readout_s = 0.03
    live = _live(readout_s=readout_s)
    for c, camera in enumerate(live.rig):
        seen = seen_points(live, c, slice(3, 8))
        row_share = seen.xy_img[..., 1] / (camera.size_wh[1] - 1) - 0.5
        t_s = live.shots[c].t_ns[3:8, None] / 1e9 + readout_s * row_share
        for q in ANATOMICAL23.indices(["nose", "right_elbow", "right_wrist"]):
            there, inside = live.keypoints(t_s[:, q])[:, 0, q], seen.possible[:, q]
            # a parabola through three moments of the readout
            assert np.linalg.norm(there - seen.xyz_world[:, q], axis=-1)[inside].max(initial=0) < 2e-4
    frozen = seen_points(_live(), 0, slice(3, 8))
    assert np.nanmax(np.abs(frozen.xy_img - seen_points(live, 0, slice(3, 8)).xy_img)) > 1


@pytest.mark.parametrize("distortion", [[-0.3, 0.0, 0.0, 0.0], [0.1, -0.25, 0.0, 0.0, 0.05], []])
def test_a_person_far_outside_the_image_is_not_seen_through_any_lens(distortion: list[float]) -> None:
    """The first lens model bends rays that are 60 degrees off its axis back into the image."""
    eye = {"name": "eye", "position_m": [0, 0, 1.5], "look_at_m": [3, 0, 1.0], "image": {"distortion": distortion}}
    people = [{"motion": {"kind": "idle", "position_m": position}} for position in ([0.9, 1.7], [3.0, 0.0])]
    aside, ahead = truth_of(scene(rate_hz=2, cameras=listed(eye), people=people)).views[0].visible.mean(axis=(0, 2))
    assert aside == 0 and ahead > 0.6


def test_a_waved_cube_stays_in_its_box_and_moves_at_about_its_speed():
    path = {"kind": "waved", "centre_m": [0.2, -0.1, 1.0], "extent_m": [1.8, 1.2, 0.8], "speed_mps": 0.7, "turn_dps": 60.0}
    live = live_scene(scene(duration_s=60, rate_hz=30, props=[{"kind": "aruco_cube", "path": path}]))
    t_s = live.t_ns / 1e9
    pose = live.prop_poses(t_s)[0]
    assert (np.abs(pose.xyz - [0.2, -0.1, 1.0]) <= np.array([0.9, 0.6, 0.4]) + 1e-9).all()
    speed = np.linalg.norm(np.gradient(pose.xyz, t_s, axis=0), axis=-1)
    assert speed.mean() == pytest.approx(0.7, rel=0.5)
    # calibration needs it seen from all sides: every face looks up at some time
    up = pose.matrix()[:, 2]
    assert (up.max(axis=0) > 0.6).all() and (up.min(axis=0) < -0.6).all()
    turn = (pose[np.arange(len(t_s) - 1)].inverse() @ pose[np.arange(1, len(t_s))]).rotvec()
    assert np.rad2deg(np.linalg.norm(turn, axis=-1)).mean() * 30 == pytest.approx(60.0, rel=0.9)


# --- geometry of what hides what


_EYE = np.array([4.0, -0.3, 1.6])


def _contains(box: Box, xyz_world: np.ndarray) -> np.ndarray:
    """(...) whether points (..., 3) are inside."""
    return (np.abs(box.world_from_box.inverse() @ xyz_world) <= box.half_m).all(axis=-1)


def test_a_box_hides_as_many_small_steps_along_the_line_say():
    rng = np.random.default_rng(5)
    box = Box(np.array([0.5, 0.2, 0.8]), SE3.from_rotvec([0.2, -0.4, 1.1], [1.0, 0.2, 1.1]), (0.5, 0.5, 0.5))
    points = rng.uniform([-2, -2, 0], [3, 2, 3], (400, 3))
    steps = np.linspace(0, 1, 4001)[:, None, None]
    met = _contains(box, _EYE + steps * (points - _EYE)).any(axis=0)
    hidden = box.between(_EYE, points)
    assert 20 < met.sum() < 380
    # steps may miss a corner that is only grazed
    assert (met <= hidden).all() and (hidden & ~met).sum() <= 4


def test_a_line_along_a_face_is_decided_without_noise():
    box = Box(np.ones(3), SE3.identity(), (0, 0, 0))
    with np.errstate(all="raise", divide="ignore", invalid="ignore"):
        assert not box.between(np.array([3.0, 2.0, 0.0]), np.array([[-3.0, 2.0, 0.0]]))[0]
        assert box.between(np.array([3.0, 0.5, 0.0]), np.array([[-3.0, 0.5, 0.0]]))[0]


def test_a_wall_stands_between_its_points():
    wall = boxes_of((WallOccluder(kind="wall", from_m=(-1.0, 1.0), to_m=(1.0, 3.0), height_m=1.5),), 0)[0]
    assert _contains(wall, np.array([[0.0, 2.0, 0.1], [-0.99, 1.01, 1.49], [0.99, 2.99, 0.75]])).all()
    assert not _contains(wall, np.array([[0.0, 2.0, 1.6], [0.3, 1.7, 0.5], [1.2, 3.2, 0.5]])).any()


def test_clutter_keeps_its_distance_and_its_seed():
    clutter = ClutterOccluder(kind="clutter", count=7, keep_clear_m=1.2)
    boxes = boxes_of((clutter,), 4)
    assert len(boxes) == 7
    around = np.linspace(0, 2 * np.pi, 60)
    ring = np.stack([1.15 * np.cos(around), 1.15 * np.sin(around), np.full(60, 0.1)], axis=-1)
    assert not any(_contains(box, ring).any() for box in boxes)
    np.testing.assert_array_equal(boxes[3].half_m, boxes_of((clutter,), 4)[3].half_m)
    assert not np.array_equal(boxes[3].half_m, boxes_of((clutter,), 5)[3].half_m)


def test_a_person_in_front_hides_and_no_person_hides_the_side_that_is_seen():
    people = np.stack([standing(x, skeleton=ANATOMICAL23) for x in (0.0, 1.5)])[None]
    flesh = np.tile(FLESH_M, 2)
    eye = np.array([5.0, 0.0, 1.4])
    hidden = hidden_by_shapes(eye, people.reshape(1, -1, 3), flesh, (), people).reshape(2, -1)
    heels = ANATOMICAL23.indices(["left_heel", "right_heel"])
    np.testing.assert_array_equal(np.flatnonzero(hidden[1]), heels)
    torso = ANATOMICAL23.indices(["left_shoulder", "right_hip", "left_knee"])
    assert hidden[0][torso].all()


# --- what is printed


_BOARDS = [((7, 5), 0.10, 0.075), ((9, 6), 0.05, 0.0371), ((4, 3), 0.2, 0.11)]


@pytest.mark.parametrize(
    "settings",
    [
        *(CharucoBoard(kind="charuco_board", squares=n, square_m=s, marker_m=m) for n, s, m in _BOARDS),
        ArucoCube(kind="aruco_cube", side_m=0.31, marker_m=0.17),
        GroundTile(kind="ground_tile", side_m=0.53, marker_m=0.41),
    ],
)
def test_the_black_of_a_marker_is_printed_from_corner_to_corner(settings):
    prop = prop_from_settings(settings)
    black = 1 - prop.texture[..., 0] / prop.texture.max()
    for marker, corners in enumerate(marker_corners(settings)):
        px_from_prop = _texture_px_from_prop(prop, face=marker if settings.kind == "aruco_cube" else 4)
        begin, end = (np.append(corners[k], 1) @ px_from_prop for k in (0, 2))
        cell = (end - begin) / 6
        for axis, image in ((0, black), (1, black.T)):
            # the first cells of the border, all black, in whichever share of each pixel, and half a cell of white at both ends
            row = image[int(begin[1 - axis] + cell[1 - axis] / 2)]
            first, middle, last = (begin[axis] + cell[axis] * np.array([-0.5, 3, 6.5])).astype(int)
            found = middle - row[first:middle].sum(), middle + row[middle:last].sum()
            assert found == pytest.approx((begin[axis], end[axis]), abs=0.02)


def _texture_px_from_prop(prop: Prop, face: int) -> np.ndarray:
    """(4, 2) from x, y, z, 1 on a printed face to places in the texture, whose first pixel is 0 to 1."""
    own = 4 * face + np.arange(4)
    ends = np.concatenate([prop.vertices[own], np.ones((4, 1))], axis=1)
    height, width = prop.texture.shape[:2]
    return np.linalg.lstsq(ends, prop.uv[own] * [width, height], rcond=None)[0]
