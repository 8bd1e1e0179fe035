"""One time step: people come out where they stand, and what gives no point is missing."""

from dataclasses import replace

import numpy as np
import pytest
from built import standing, views

from posefuse.core import SKELETONS, Kind, Rig, ShapeError
from posefuse.fusion import WEIGHTS, FuseSettings, fuse, triangulate
from posefuse.fusion.kernels import robust

COCO, PAPER = SKELETONS["coco17"], SKELETONS["paper14"]
STANDING = standing()


@pytest.mark.parametrize("weights", WEIGHTS)
def test_people_come_out_where_they_stand(ring_rig, weights):
    rig = ring_rig(5)
    people = np.stack([STANDING, STANDING + [0.5, 1.0, 0]])
    pose = fuse(views(rig, people), rig, FuseSettings(weights=weights))
    np.testing.assert_allclose(pose.xyz_world, people, atol=1e-9)
    assert pose.person_id.tolist() == [0, 1]
    assert (pose.kind == Kind.FUSED).all()
    assert (pose.n_views == 5).all()


def test_a_keypoint_of_one_view_is_missing_not_invented(ring_rig):
    rig = ring_rig(4)
    seen = views(rig, STANDING[None])
    xy, score = seen.xy_img.copy(), seen.score.copy()
    xy[0, 1:, 3], score[0, 1:, 3] = np.nan, 0
    pose = fuse(replace(seen, t_ns=7, person_id=[4], xy_img=xy, score=score), rig, FuseSettings())
    assert pose.kind[0, 3] == Kind.MISSING
    assert np.isnan(pose.xyz_world[0, 3]).all()
    assert np.isnan(pose.cov_world[0, 3]).all()
    assert np.isnan(pose.reproj_px[0, 3])
    assert pose.n_views[0, 3] == 0
    assert (np.delete(pose.kind[0], 3) == Kind.FUSED).all()
    assert (pose.t_ns, pose.person_id.tolist()) == (7, [4])


def test_two_rays_that_do_not_meet_are_no_point(ring_rig):
    rig = ring_rig(2)
    seen = views(rig, STANDING[None])
    xy = seen.xy_img.copy()
    xy[0, 0, 5, 1] += 200
    pose = fuse(replace(seen, xy_img=xy), rig, FuseSettings())
    assert pose.kind[0, 5] == Kind.MISSING
    assert pose.kind[0, 6] == Kind.FUSED


def test_all_takes_segments_from_the_previous_pose_of_the_same_person(ring_rig):
    rig = ring_rig(4)
    noisy = views(rig, np.stack([STANDING, STANDING + [1, 0, 0]]), sigma_px=5.0, seed=0)
    settings = FuseSettings(weights="all")
    alone = fuse(noisy, rig, settings)
    lying = fuse(views(rig, (STANDING @ np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]))[None]), rig, settings)
    after = fuse(noisy, rig, settings, lying)
    assert np.abs(after.xyz_world[0] - alone.xyz_world[0]).max() > 1e-4
    np.testing.assert_array_equal(after.xyz_world[1], alone.xyz_world[1])


def test_views_of_other_cameras_are_refused(ring_rig):
    with pytest.raises(ShapeError, match="views come from cameras cam00, cam01, the rig has cam00, cam01, cam02"):
        fuse(views(ring_rig(2), STANDING[None]), ring_rig(3), FuseSettings())


def test_one_compilation_serves_every_call(ring_rig):
    """Another memory order or a read-only array would compile the kernels again: seconds, in the middle of a recording."""
    rig = ring_rig(4)
    seen = views(rig, STANDING[None], sigma_px=1.0, seed=2)
    before = fuse(seen, rig, FuseSettings())
    for weights in WEIGHTS:
        triangulate(rig, seen.xy_img, seen.score, seen.sigma_px, weights, skeleton=COCO)
    kernels = (robust.solve_robust, robust.inflate)
    # other tests of this process may have had them compiled for other types
    compiled = [len(kernel.signatures) for kernel in kernels]
    fuse(seen, rig, FuseSettings(), before)
    for weights in WEIGHTS:
        triangulate(rig, seen.xy_img[0, :, :14].astype(np.float32), weights=weights, skeleton=PAPER)
    assert min(compiled) > 0 and [len(kernel.signatures) for kernel in kernels] == compiled


# --- what is odd about views


def views_at(rig, xy, score=1.0):
    """Of no stated noise."""
    score, sigma = np.broadcast_to(score, xy.shape[:-1]), np.full(xy.shape[:-1], np.nan)
    return replace(views(rig, np.ones((len(xy), 17, 3))), xy_img=xy, score=score, sigma_px=sigma)


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
    pose = fuse(views_at(rig, xy if seen else xy * np.nan, 1.0 * seen), rig, settings)
    assert pose.xyz_world.shape == (len(xy), 17, 3)
    assert (pose.kind == Kind.MISSING).all() and np.isnan(pose.xyz_world).all()


def test_nan_scores_are_unseen(ring_rig, settings, person):
    rig = ring_rig(4)
    xy = np.moveaxis(rig.project(person), 0, 1)
    score = np.ones((1, 4, 17))
    score[0, 2:, 5] = np.nan
    score[0, 1:, 6] = np.nan
    pose = fuse(views_at(rig, xy, score), rig, settings)
    assert pose.n_views[0, 4:7].tolist() == [4, 2, 0]


def test_infinite_pixels_are_unseen(ring_rig, settings, person):
    rig = ring_rig(4)
    xy = np.moveaxis(rig.project(person), 0, 1)
    xy[0, 1, 3, 0] = np.inf
    pose = fuse(views_at(rig, xy), rig, settings)
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


def test_one_keypoint_alone_none_and_no_groups(ring_rig, person):
    rig = ring_rig(3)
    np.testing.assert_allclose(triangulate(rig, rig.project(person[0, :1])).xyz, person[0, :1], atol=1e-9)
    assert triangulate(rig, np.zeros((2, 3, 0, 2))).xyz.shape == (2, 0, 3)
    assert triangulate(rig, np.zeros((0, 3, 5, 2))).xyz.shape == (0, 5, 3)


def test_forty_cameras_with_half_of_them_wrong(ring_rig, person):
    rig = ring_rig(40)
    xy = rig.project(person[0])
    xy[::2] += np.random.default_rng(1).uniform(50, 300, (20, 17, 2))
    found = triangulate(rig, xy, sigma_px=np.ones((40, 17)))
    np.testing.assert_allclose(found.xyz, person[0], atol=1e-3)
