from dataclasses import replace

import built
import numpy as np
import pytest

from posefuse.core import SKELETONS, Kind, Rig
from posefuse.fusion import WEIGHTS, FuseSettings, fuse, triangulate

COCO = SKELETONS["coco17"]


def views(rig, xy, score=1.0):
    """Of no stated noise."""
    score, sigma = np.broadcast_to(score, xy.shape[:-1]), np.full(xy.shape[:-1], np.nan)
    return replace(built.views(rig, np.ones((len(xy), 17, 3))), xy_img=xy, score=score, sigma_px=sigma)


@pytest.fixture
def person():
    return np.random.default_rng(0).normal(size=(1, 17, 3)) * 0.4 + [0, 0, 1]


@pytest.fixture(params=WEIGHTS)
def settings(request):
    return FuseSettings(weights=request.param)


@pytest.mark.parametrize("given", ["no person", "one camera", "a camera listed twice", "nothing seen"])
def test_what_gives_no_point_is_missing(ring_rig, settings, person, given):
    rig = ring_rig(3)
    if given in ("one camera", "a camera listed twice"):
        one = Rig(rig.cameras[:1])
        rig = one if given == "one camera" else Rig((*one, *one.renamed({one.names[0]: "again"})))
    xy = np.moveaxis(rig.project(person[:0] if given == "no person" else person), 0, 1)
    seen = given != "nothing seen"
    pose = fuse(views(rig, xy if seen else xy * np.nan, 1.0 * seen), rig, settings)
    assert pose.xyz_world.shape == (len(xy), 17, 3)
    assert (pose.kind == Kind.MISSING).all() and np.isnan(pose.xyz_world).all()


def test_nan_scores_are_unseen(ring_rig, settings, person):
    rig = ring_rig(4)
    xy = np.moveaxis(rig.project(person), 0, 1)
    score = np.ones((1, 4, 17))
    score[0, 2:, 5] = np.nan
    score[0, 1:, 6] = np.nan
    pose = fuse(views(rig, xy, score), rig, settings)
    assert pose.n_views[0, 4:7].tolist() == [4, 2, 0]


def test_infinite_pixels_are_unseen(ring_rig, settings, person):
    rig = ring_rig(4)
    xy = np.moveaxis(rig.project(person), 0, 1)
    xy[0, 1, 3, 0] = np.inf
    pose = fuse(views(rig, xy), rig, settings)
    np.testing.assert_allclose(pose.xyz_world, person, atol=1e-9)
    assert pose.n_views[0, 3] == 3


def test_a_point_behind_a_camera_is_not_seen_by_it(ring_rig, person):
    """Its rays meet behind both cameras: no weighting may put a point there."""
    rig = Rig(ring_rig(4).cameras[:2])
    xy = rig.project(person)[:, 0]
    behind = 4 * rig.centres_world().mean(axis=0) - person[0]
    xyz_cam = [camera.cam_from_world @ behind for camera in rig]
    assert all((p[:, 2] < 0).all() for p in xyz_cam)
    xy = np.stack([camera.px_from_norm(p[:, :2] / p[:, 2:]) for camera, p in zip(rig, xyz_cam, strict=True)])
    for weights in ("none", "score", "robust"):
        found = triangulate(rig, xy, weights=weights)
        assert (found.n_views == 0).all(), weights


def test_one_keypoint_alone(ring_rig, person):
    rig = ring_rig(3)
    xy = rig.project(person[0, :1])
    np.testing.assert_allclose(triangulate(rig, xy).xyz, person[0, :1], atol=1e-9)


def test_no_keypoints_and_no_groups(ring_rig):
    rig = ring_rig(3)
    assert triangulate(rig, np.zeros((2, 3, 0, 2))).xyz.shape == (2, 0, 3)
    assert triangulate(rig, np.zeros((0, 3, 5, 2))).xyz.shape == (0, 5, 3)


def test_forty_cameras_with_half_of_them_wrong(ring_rig, person):
    rig = ring_rig(40)
    xy = rig.project(person[0])
    xy[::2] += np.random.default_rng(1).uniform(50, 300, (20, 17, 2))
    found = triangulate(rig, xy, sigma_px=np.ones((40, 17)))
    np.testing.assert_allclose(found.xyz, person[0], atol=1e-3)
