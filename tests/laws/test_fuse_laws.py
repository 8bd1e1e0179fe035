import dataclasses

import numpy as np
import pytest

from posefuse.core import SE3, SKELETONS, Camera, Rig
from posefuse.fusion import WEIGHTS, triangulate

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
