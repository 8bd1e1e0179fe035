from dataclasses import replace

import numpy as np
import pytest
from built import views

from posefuse.core import SKELETONS, Kind, ShapeError
from posefuse.fusion import WEIGHTS, FuseSettings, fuse, triangulate
from posefuse.fusion.kernels import linear, robust

COCO, PAPER = SKELETONS["coco17"], SKELETONS["paper14"]


@pytest.mark.parametrize("weights", WEIGHTS)
def test_people_come_out_where_they_stand(ring_rig, standing, weights):
    rig = ring_rig(5)
    people = np.stack([standing, standing + [0.5, 1.0, 0]])
    pose = fuse(views(rig, people), rig, FuseSettings(weights=weights))
    np.testing.assert_allclose(pose.xyz_world, people, atol=1e-9)
    assert pose.person_id.tolist() == [0, 1]
    assert (pose.kind == Kind.FUSED).all()
    assert (pose.n_views == 5).all()


def test_a_keypoint_of_one_view_is_missing_not_invented(ring_rig, standing):
    rig = ring_rig(4)
    seen = views(rig, standing[None])
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


def test_two_rays_that_do_not_meet_are_no_point(ring_rig, standing):
    rig = ring_rig(2)
    seen = views(rig, standing[None])
    xy = seen.xy_img.copy()
    xy[0, 0, 5, 1] += 200
    pose = fuse(replace(seen, xy_img=xy), rig, FuseSettings())
    assert pose.kind[0, 5] == Kind.MISSING
    assert pose.kind[0, 6] == Kind.FUSED


def test_all_takes_segments_from_the_previous_pose_of_the_same_person(ring_rig, standing):
    rig = ring_rig(4)
    noisy = views(rig, np.stack([standing, standing + [1, 0, 0]]), sigma_px=5.0, seed=0)
    settings = FuseSettings(weights="all")
    alone = fuse(noisy, rig, settings)
    lying = fuse(views(rig, (standing @ np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]]))[None]), rig, settings)
    after = fuse(noisy, rig, settings, lying)
    assert np.abs(after.xyz_world[0] - alone.xyz_world[0]).max() > 1e-4
    np.testing.assert_array_equal(after.xyz_world[1], alone.xyz_world[1])


def test_views_of_other_cameras_are_refused(ring_rig, standing):
    with pytest.raises(ShapeError, match="views come from cameras cam00, cam01, the rig has cam00, cam01, cam02"):
        fuse(views(ring_rig(2), standing[None]), ring_rig(3), FuseSettings())


def test_one_compilation_serves_every_call(ring_rig, standing):
    """Another memory order or a read-only array would compile the kernels again: seconds, in the middle of a recording."""
    rig = ring_rig(4)
    seen = views(rig, standing[None], sigma_px=1.0, seed=2)
    before = fuse(seen, rig, FuseSettings())
    for weights in WEIGHTS:
        triangulate(rig, seen.xy_img, seen.score, seen.sigma_px, weights, skeleton=COCO)
    kernels = (robust.solve_robust, linear.solve_linear)
    # other tests of this process may have had them compiled for other types
    compiled = [len(kernel.signatures) for kernel in kernels]
    fuse(seen, rig, FuseSettings(), before)
    for weights in WEIGHTS:
        triangulate(rig, seen.xy_img[0, :, :14].astype(np.float32), weights=weights, skeleton=PAPER)
    assert min(compiled) > 0 and [len(kernel.signatures) for kernel in kernels] == compiled
