from dataclasses import replace

import numpy as np
import pytest

from posefuse.core import SKELETONS, Views
from posefuse.fusion import WEIGHTS, FuseSettings, fuse, sides, triangulate
from posefuse.fusion.kernels import linear, robust
from posefuse.fusion.sides import limb_groups

COCO, PAPER = SKELETONS["coco17"], SKELETONS["paper14"]
GROUPS = dict(zip(("body", "arms", "legs", "head"), limb_groups(COCO), strict=True))


def exchanged(views: Views, cameras: list[int], group: np.ndarray, person: int = 0) -> Views:
    planes = {name: getattr(views, name).copy() for name in ("xy_img", "score", "sigma_px")}
    for plane in planes.values():
        for camera in cameras:
            plane[person, camera, group] = plane[person, camera, COCO.mirror[group]]
    return replace(views, **planes)


@pytest.mark.parametrize("count", [3, 4, 7])
@pytest.mark.parametrize("limb", ["body", "arms", "legs"])
def test_a_view_with_sides_exchanged_is_put_right(ring_rig, standing, views_of, count, limb):
    rig = ring_rig(count)
    right = views_of(rig, COCO, standing[None], sigma_px=1.0, seed=2)
    for camera in range(count):
        found = fuse(exchanged(right, [camera], GROUPS[limb]), rig, FuseSettings())
        expected = fuse(right, rig, FuseSettings())
        np.testing.assert_allclose(found.xyz_world, expected.xyz_world, atol=2e-3)
        assert (found.n_views[0, GROUPS[limb]] == expected.n_views[0, GROUPS[limb]]).all()


def test_without_the_test_the_view_is_only_left_out(ring_rig, standing, views_of):
    rig = ring_rig(4)
    wrong = exchanged(views_of(rig, COCO, standing[None], sigma_px=1.0, seed=2), [1], GROUPS["body"])
    arms = COCO.indices(["left_wrist", "right_wrist", "left_ankle", "right_ankle"])
    assert (fuse(wrong, rig, FuseSettings(swap_correction=False)).n_views[0, arms] == 3).all()
    assert (fuse(wrong, rig, FuseSettings()).n_views[0, arms] == 4).all()


def test_views_that_agree_are_left_alone_even_when_all_name_the_other_side(ring_rig, standing, views_of):
    rig = ring_rig(4)
    every = exchanged(views_of(rig, COCO, standing[None], sigma_px=1.0, seed=2), [0, 1, 2, 3], GROUPS["body"])
    found = fuse(every, rig, FuseSettings()).xyz_world[0]
    np.testing.assert_allclose(found[GROUPS["body"]], standing[COCO.mirror][GROUPS["body"]], atol=0.05)


def test_the_previous_pose_decides_when_half_of_the_views_say_otherwise(ring_rig, standing, views_of):
    rig = ring_rig(4)
    right = views_of(rig, COCO, standing[None], sigma_px=1.0, seed=2)
    before = fuse(right, rig, FuseSettings())
    for half in ([0, 1], [1, 2], [2, 3], [0, 3], [0, 2]):
        found = fuse(exchanged(right, half, GROUPS["body"]), rig, FuseSettings(), before)
        np.testing.assert_allclose(found.xyz_world[0], standing, atol=0.05)


def test_the_other_person_is_not_touched(ring_rig, standing, views_of):
    rig = ring_rig(4)
    right = views_of(rig, COCO, np.stack([standing, standing + [0, 1.5, 0]]), sigma_px=1.0, seed=2)
    found = fuse(exchanged(right, [2], GROUPS["legs"], person=1), rig, FuseSettings())
    np.testing.assert_array_equal(found.xyz_world[0], fuse(right, rig, FuseSettings()).xyz_world[0])
    np.testing.assert_allclose(found.xyz_world[1], fuse(right, rig, FuseSettings()).xyz_world[1], atol=2e-3)


def test_one_compilation_serves_every_call(ring_rig, standing, views_of):
    """Another memory order or a read-only array would compile the kernels again: seconds, in the middle of a recording."""
    rig = ring_rig(4)
    right = views_of(rig, COCO, standing[None], sigma_px=1.0, seed=2)
    before = fuse(right, rig, FuseSettings())
    fuse(exchanged(right, [0, 1], GROUPS["body"]), rig, FuseSettings())
    kernels = (robust.solve_robust, linear.solve_linear, robust.squares_of)
    for weights in WEIGHTS:
        triangulate(rig, right.xy_img, right.score, right.sigma_px, weights, skeleton=COCO)
    # other tests of this process may have had them compiled for other types
    compiled = [len(kernel.signatures) for kernel in kernels]
    fuse(exchanged(right, [0, 1], GROUPS["body"]), rig, FuseSettings(), before)
    for weights in WEIGHTS:
        triangulate(rig, right.xy_img[0, :, :14].astype(np.float32), weights=weights, skeleton=PAPER)
    assert min(compiled) > 0 and [len(kernel.signatures) for kernel in kernels] == compiled


@pytest.mark.parametrize("voted", [True, False])
def test_wrong_keypoints_are_not_taken_for_exchanged_sides(ring_rig, standing, views_of, voted, monkeypatch):
    """A fifth of the keypoints elsewhere, and nothing exchanged: by the loss alone, without the vote, views would be."""
    if not voted:
        monkeypatch.setattr(sides, "_votes", lambda before, after: np.ones(len(before)))
    rig, rng = ring_rig(4), np.random.default_rng(6)
    exchanges = 0
    for seed in range(12):
        seen = views_of(rig, COCO, standing[None], sigma_px=4.0, seed=seed)
        xy = seen.xy_img.copy()
        wrong = rng.random(xy.shape[:-1]) < 0.2
        xy[wrong] += rng.uniform(-60, 60, (int(wrong.sum()), 2))
        planes = xy.copy(), seen.score.copy(), seen.sigma_px.copy()
        sides.solve_with_swaps_corrected(rig, *planes, COCO, None, FuseSettings())
        exchanges += int((planes[0] != xy).any(axis=(0, 2, 3)).sum())
    assert exchanges <= 1 if voted else exchanges >= 5
