import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from built import views

from posefuse.core import SE3, SKELETONS, Camera, Kind, Rig
from posefuse.core.depth import keypoint_depth
from posefuse.fusion import WEIGHTS, FuseSettings, fuse, triangulate

COCO = SKELETONS["coco17"]
LENS = (-0.2, 0.05, 0.001, -0.002, 0.01)


@pytest.fixture
def scene(ring_rig):
    """Five cameras, three people of 17 keypoints with noise, some keypoints missing and some wrong."""
    rig = ring_rig(5, distortion=LENS)
    rng = np.random.default_rng(0)
    xyz = rng.normal(size=(3, 17, 3)) * 0.4 + [0.2, -0.1, 1]
    xy = np.moveaxis(rig.project(xyz), 0, -3) + rng.normal(size=(3, 5, 17, 2)) * 1.5
    score = rng.uniform(0.3, 1.0, (3, 5, 17))
    xy[rng.random(score.shape) < 0.1] = np.nan
    xy[rng.random(score.shape) < 0.05] += 90
    return rig, xy, score, np.full(score.shape, 1.5)


@pytest.mark.parametrize("weights", WEIGHTS)
def test_moving_the_world_moves_the_answer(scene, weights):
    rig, xy, score, sigma = scene
    move = SE3.from_rotvec([0.3, -1.1, 2.0], [5.0, -3.0, 0.7])
    here = triangulate(rig, xy, score, sigma, weights, skeleton=COCO)
    there = triangulate(rig.moved(move), xy, score, sigma, weights, skeleton=COCO)
    np.testing.assert_allclose(there.xyz, move @ here.xyz, atol=1e-6)
    turn = move.matrix()
    np.testing.assert_allclose(there.cov, turn @ here.cov @ turn.T, rtol=1e-4, atol=1e-9)
    np.testing.assert_array_equal(there.n_views, here.n_views)


@pytest.mark.parametrize("weights", WEIGHTS)
def test_the_order_of_cameras_does_not_matter(scene, weights):
    rig, xy, score, sigma = scene
    order = [3, 0, 4, 2, 1]
    here = triangulate(rig, xy, score, sigma, weights, skeleton=COCO)
    shuffled = Rig(tuple(rig.cameras[i] for i in order))
    there = triangulate(shuffled, xy[:, order], score[:, order], sigma[:, order], weights, skeleton=COCO)
    np.testing.assert_allclose(there.xyz, here.xyz, atol=1e-6)
    np.testing.assert_array_equal(there.n_views, here.n_views)


def mirrored(camera: Camera) -> Camera:
    """The camera of the world reflected in x: its image is reflected left to right."""
    flip = np.diag([-1.0, 1.0, 1.0])
    intrinsics = camera.K.copy()
    intrinsics[0, 2] = camera.size_wh[0] - 1 - intrinsics[0, 2]
    lens = camera.distortion.copy()
    lens[3] *= -1
    pose = SE3.from_matrix(flip @ camera.cam_from_world.matrix() @ flip, flip @ camera.cam_from_world.xyz)
    return dataclasses.replace(camera, K=intrinsics, distortion=lens, cam_from_world=pose)


@pytest.mark.parametrize("weights", WEIGHTS)
def test_the_mirror_image_gives_the_mirror_pose(scene, weights):
    rig, xy, score, sigma = scene
    here = triangulate(rig, xy, score, sigma, weights, skeleton=COCO)
    reflected = xy.copy()
    reflected[..., 0] = rig.cameras[0].size_wh[0] - 1 - reflected[..., 0]
    swap = COCO.mirror
    seen = reflected[..., swap, :], score[..., swap], sigma[..., swap]
    there = triangulate(Rig(tuple(map(mirrored, rig))), *seen, weights, skeleton=COCO)
    np.testing.assert_allclose(there.xyz[:, swap], here.xyz * [-1, 1, 1], atol=1e-6)


def bodies_seen(ring_rig, count, sigma_px):
    """A rig, 300 bodies, what it sees of them with noise of this size, and the random numbers that come next."""
    rig, rng = ring_rig(count, distortion=LENS), np.random.default_rng(count)
    xyz = rng.normal(size=(300, 17, 3)) * 0.4 + [0, 0, 1]
    xy = np.moveaxis(rig.project(xyz), 0, 1)
    return rig, xyz, xy + rng.normal(size=xy.shape) * sigma_px, rng


@pytest.mark.parametrize("count", [2, 3, 4, 8])
@pytest.mark.parametrize("weights", ["none", "robust"])
def test_covariance_matches_the_errors(ring_rig, count, weights):
    """NEES of 3 with correct sigma, different in each camera."""
    sigma = np.broadcast_to(np.linspace(0.7, 3.0, count)[:, None], (300, count, 17))
    rig, xyz, xy, _ = bodies_seen(ring_rig, count, sigma[..., None])
    assert nees(triangulate(rig, xy, sigma_px=sigma, weights=weights), xyz) == pytest.approx(3.0, abs=0.3)


@pytest.mark.parametrize(("count", "wrong"), [(4, 0.05), (8, 0.1), (16, 0.2)])
def test_covariance_matches_the_errors_with_outliers(ring_rig, count, wrong):
    rig, xyz, xy, rng = bodies_seen(ring_rig, count, 2.0)
    bad = rng.random(xy.shape[:-1]) < wrong
    # at most all but three views, so that the truth can be determined
    bad &= np.cumsum(bad, axis=1) <= count - 3
    xy[bad] += rng.uniform(80, 200, (bad.sum(), 2)) * rng.choice([-1, 1], (bad.sum(), 2))
    found = triangulate(rig, xy, sigma_px=np.full(xy.shape[:-1], 2.0))
    assert nees(found, xyz) == pytest.approx(3.0, abs=0.4)


def test_understated_sigma_shows_in_the_covariance(ring_rig):
    rig, xyz, xy, _ = bodies_seen(ring_rig, 6, 4.0)
    for weights in ("robust", "none"):
        assert nees(triangulate(rig, xy, sigma_px=np.full(xy.shape[:-1], 1.0), weights=weights), xyz) < 5


def nees(found, xyz):
    error = found.xyz - xyz
    squared = np.einsum("gki,gkij,gkj->gk", error, np.linalg.inv(found.cov), error)
    # one in a thousand may be the unlucky agreement of wrong views, which no covariance foretells
    return float(np.sort(squared, axis=None)[: int(0.999 * squared.size)].mean())


# --- depth as one more measurement per view: what it may and may not do to a point


SIGMA_PX, SIGMA_M = 2.0, 0.03


def bodies(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 17, 3)) * 0.4 + [0, 0, 1]


def seen_by(rig, xyz, seed=1, sigma_m=SIGMA_M):
    """Noisy px (G, C, K, 2) and depth (G, C, K, 2) of points (G, K, 3)."""
    rng = np.random.default_rng(seed)
    xy = np.moveaxis(rig.project(xyz), 0, 1)
    xy = xy + rng.normal(size=xy.shape) * SIGMA_PX
    z = np.stack([(camera.cam_from_world @ xyz)[..., 2] for camera in rig], axis=1)
    depth = np.stack([z + rng.normal(size=z.shape) * sigma_m, np.full(z.shape, sigma_m)], axis=-1)
    return xy, np.full(z.shape, SIGMA_PX), depth


@pytest.mark.parametrize("count", [1, 2, 4])
def test_covariance_matches_the_errors_with_depth(ring_rig, count):
    """NEES of 3; one camera alone is within its sigma of the truth."""
    rig, xyz = ring_rig(count, distortion=LENS), bodies(300)
    xy, sigma, depth = seen_by(rig, xyz)
    found = triangulate(rig, xy, sigma_px=sigma, depth_m=depth)
    assert np.isfinite(found.xyz).all()
    assert nees(found, xyz) == pytest.approx(3.0, abs=0.3)


def test_depth_makes_a_point_better_where_rays_say_little(ring_rig):
    """Two cameras side by side: their rays hardly tell how far away a point is."""
    rig, xyz = ring_rig(24, distortion=LENS), bodies(100)
    rig = type(rig)(rig.cameras[:2])
    xy, sigma, depth = seen_by(rig, xyz)
    without = triangulate(rig, xy, sigma_px=sigma)
    better = triangulate(rig, xy, sigma_px=sigma, depth_m=depth)
    error, error_without = (np.sqrt(np.nanmean((one.xyz - xyz) ** 2)) for one in (better, without))
    assert error < 0.7 * error_without


@pytest.mark.parametrize("count", [2, 4])
def test_depth_of_infinite_sigma_changes_nothing(ring_rig, count):
    rig, xyz = ring_rig(count, distortion=LENS), bodies(20)
    xy, sigma, depth = seen_by(rig, xyz)
    depth[..., 1] = np.inf
    without, with_depth = triangulate(rig, xy, sigma_px=sigma), triangulate(rig, xy, sigma_px=sigma, depth_m=depth)
    for name in ("xyz", "cov", "reproj", "n_views"):
        np.testing.assert_array_equal(getattr(with_depth, name), getattr(without, name))
    # one depth that is known compiles kernels with depth: the other points are the same but for the last bits
    depth[0, 0, 0, 1] = SIGMA_M
    mixed = triangulate(rig, xy, sigma_px=sigma, depth_m=depth)
    np.testing.assert_allclose(mixed.xyz[1:], without.xyz[1:], atol=1e-9)
    assert not np.allclose(mixed.xyz[0, 0], without.xyz[0, 0], atol=1e-7)


@pytest.mark.parametrize("count", [1, 3])
def test_moving_the_world_moves_the_answer_with_depth(ring_rig, count):
    rig, xyz = ring_rig(count, distortion=LENS), bodies(5)
    xy, sigma, depth = seen_by(rig, xyz)
    depth[:, :, ::3] = np.nan
    move = SE3.from_rotvec([0.3, -1.1, 2.0], [5.0, -3.0, 0.7])
    here = triangulate(rig, xy, sigma_px=sigma, depth_m=depth)
    there = triangulate(rig.moved(move), xy, sigma_px=sigma, depth_m=depth)
    np.testing.assert_allclose(there.xyz, move @ here.xyz, atol=1e-6)
    np.testing.assert_allclose(there.cov, move.matrix() @ here.cov @ move.matrix().T, rtol=1e-4, atol=1e-9)
    np.testing.assert_array_equal(there.n_views, here.n_views)


def test_depth_of_what_stands_in_front_is_bounded(ring_rig):
    """However wrong the depth of one of four views is, the point moves about as far as the largest pull of the loss moves it.

    The loss is quadratic up to 3 sigma, and its slope falls from there on: 3 / sigma is the largest force. The covariance that
    turns it into a distance is that of these residuals, hence about.
    """
    rig, xyz = ring_rig(4, distortion=LENS), bodies(40)
    xy, sigma, depth = seen_by(rig, xyz)
    without = triangulate(rig, xy, sigma_px=sigma)
    moved: list[np.ndarray] = []
    for before_m in (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.0):
        wrong = np.full(depth.shape, np.nan)
        wrong[:, 1] = depth[:, 1] - [before_m, 0.0]
        found = triangulate(rig, xy, sigma_px=sigma, depth_m=wrong)
        moved.append(np.linalg.norm(found.xyz - without.xyz, axis=-1))
    axis = rig.cameras[1].cam_from_world.matrix()[2]
    bound = np.linalg.norm(without.cov @ axis, axis=-1) * 3 / SIGMA_M
    share = np.array(moved) / bound
    assert np.quantile(share, 0.99) < 1.3
    assert share.max() < 2
    # half a metre in front, it is hardly noticed any more
    assert np.quantile(share[4:], 0.99) < 0.01


def test_one_view_that_others_contradict_is_no_point_even_with_depth(ring_rig):
    rig, xyz = ring_rig(2, distortion=LENS), bodies(3)
    xy, sigma, depth = seen_by(rig, xyz)
    xy[:, 1, 0] += 150
    found = triangulate(rig, xy, sigma_px=sigma, depth_m=depth)
    assert np.isnan(found.xyz[:, 0]).all()
    assert np.isfinite(found.xyz[:, 1:]).all()


def test_the_surface_lies_in_front_of_the_keypoint_along_its_ray(ring_rig):
    """A sphere about each keypoint: the camera measures where its ray enters it."""
    rig, xyz = ring_rig(1), bodies(1)[0]
    camera, skeleton = rig.cameras[0], COCO
    in_camera = camera.cam_from_world @ xyz
    norm = in_camera[:, :2] / in_camera[:, 2:]
    nothing = np.zeros((17, 2))
    below_m = keypoint_depth(nothing, np.zeros((17, 2)), skeleton)[:, 0]
    entered = in_camera * (1 - below_m / np.linalg.norm(in_camera, axis=-1))[:, None]
    depth = np.stack([entered[:, 2], np.full(17, 0.01)], axis=-1)
    joints = keypoint_depth(depth, norm, skeleton)
    np.testing.assert_allclose(joints[:, 0], in_camera[:, 2], atol=1e-12)
    assert (joints[:, 1] > 0.01).all()
    seen = replace(views(rig, xyz[None]), person_id=[4], score=np.ones((1, 1, 17)), depth_m=depth[None, None])
    pose = fuse(seen, rig, FuseSettings())
    np.testing.assert_allclose(pose.xyz_world[0], xyz, atol=1e-6)
    assert (pose.kind == Kind.FUSED).all()
    assert (pose.n_views == 1).all()
