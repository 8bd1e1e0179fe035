"""Left and right over time: confused stretches are put right, clean motion is left alone."""

from dataclasses import replace

import numpy as np
import pytest
from built import noisy_views, poses, standing, unseen, view_sequence

from posefuse.core import SE3, PoseSequence
from posefuse.core.skeleton import COCO17
from posefuse.tracking import sides_like, steady_sides

T, N, K = 90, 2, len(COCO17)
LEFT_LEG = COCO17.indices(["left_hip", "left_knee", "left_ankle"])
RIGHT_LEG = COCO17.mirror[LEFT_LEG]
LEFT_ARM = COCO17.indices(["left_shoulder", "left_elbow", "left_wrist"])
# no clue to where the body faces
NOTHING = np.zeros((2, T, N))


def walkers(noise_m: float = 0.004) -> PoseSequence:
    """Two people whose legs and arms swing past each other 30 cm to either side, at 30 Hz."""
    rng = np.random.default_rng(5)
    t_s = np.arange(T) / 30
    xyz = np.tile(rng.normal(size=(1, N, K, 3)) * 0.05 + [0, 0, 1], (T, 1, 1, 1))
    xyz[..., 0] += t_s[:, None, None] + np.array([0.0, 5.0])[:, None]
    swing = 0.3 * np.sin(2 * np.pi * 0.9 * t_s)[:, None, None]
    for limb, sign in ((LEFT_LEG, 1), (RIGHT_LEG, -1), (LEFT_ARM, -1), (COCO17.mirror[LEFT_ARM], 1)):
        share = np.array([0.1, 0.6, 1.0])
        xyz[:, :, limb, 0] += sign * swing * share
        xyz[:, :, limb, 1] += 0.1 if limb is LEFT_LEG or limb is LEFT_ARM else -0.1
    xyz += rng.normal(size=xyz.shape) * noise_m
    each = 1 + np.arange(T * N * K).reshape(T, N, K, 1, 1)
    return poses(xyz, rate_hz=30.0, cov=noise_m**2 * np.eye(3) * each)


def swapped(sequence: PoseSequence, time_steps: slice, person: int, limb: np.ndarray) -> PoseSequence:
    order = np.arange(K)
    order[limb], order[COCO17.mirror[limb]] = COCO17.mirror[limb], limb
    arrays = {name: np.array(getattr(sequence, name)) for name in ("xyz_world", "cov_world")}
    for array in arrays.values():
        array[time_steps, person] = array[time_steps, person][:, order]
    return replace(sequence, **arrays)


def same(planes: tuple[np.ndarray, np.ndarray], poses: PoseSequence) -> bool:
    wanted = (poses.xyz_world, poses.cov_world)
    return all(np.array_equal(*pair, equal_nan=True) for pair in zip(planes, wanted, strict=True))


@pytest.mark.parametrize("limb", [LEFT_LEG, LEFT_ARM], ids=["legs", "arms"])
@pytest.mark.parametrize("time_steps", [slice(12, 19), slice(40, 41), slice(0, 6), slice(80, 90)])
def test_a_confused_stretch_is_put_right_with_all_that_belongs_to_it(limb: np.ndarray, time_steps: slice) -> None:
    clean = walkers()
    confused = swapped(clean, time_steps, 1, limb)
    assert not same((confused.xyz_world, confused.cov_world), clean)
    assert same(steady_sides(confused, NOTHING), clean)


def test_clean_motion_is_left_alone_even_with_gaps() -> None:
    clean = walkers()
    assert same(steady_sides(clean, NOTHING), clean)
    xyz = np.array(clean.xyz_world)
    xyz[30:34, 0] = np.nan
    xyz[:, 1, LEFT_LEG[2]] = np.nan
    holed = replace(clean, xyz_world=xyz)
    assert same(steady_sides(holed, NOTHING), holed)


def test_it_does_not_depend_on_where_the_world_is() -> None:
    confused = swapped(walkers(), slice(12, 19), 0, LEFT_LEG)
    new_from_old = SE3.from_rotvec([0.4, -1.0, 0.3], [3.0, -2.0, 1.0])
    moved = replace(confused, xyz_world=new_from_old @ confused.xyz_world)
    assert np.allclose(steady_sides(moved, NOTHING)[0], new_from_old @ steady_sides(confused, NOTHING)[0])


def test_two_time_steps_show_nothing() -> None:
    clean = walkers()
    arrays = {name: getattr(clean, name)[:2] for name in ("t_ns", "xyz_world", "cov_world", "reproj_px", "n_views", "kind")}
    short = swapped(replace(clean, **arrays), slice(1, 2), 0, LEFT_LEG)
    assert same(steady_sides(short, NOTHING[:, :2]), short)


def test_views_are_named_as_the_reference_has_them(ring_rig) -> None:
    rig, reference, rng = ring_rig(3), walkers(), np.random.default_rng(1)
    true_xy = noisy_views(rig, reference, 1.0, 1).xy_img
    true = [true_xy, *(rng.uniform(*span, true_xy.shape[:-1]) for span in ((0.5, 1), (1, 3))), rng.uniform(2, 5, true_xy.shape)]
    seen, legs = [np.array(plane) for plane in true], [*LEFT_LEG, *RIGHT_LEG]
    wrong = slice(8, 17)  # the legs are well apart
    for plane in seen:
        plane[wrong, 0, 1][:, legs] = plane[wrong, 0, 1][:, [*RIGHT_LEG, *LEFT_LEG]]
    assert not np.array_equal(seen[0], true_xy)
    got = sides_like(reference, rig, view_sequence(rig, reference, *seen[:3], depth_m=seen[3]))
    far = np.linalg.norm(true_xy[..., LEFT_LEG[2], :] - true_xy[..., RIGHT_LEG[2], :], axis=-1) > 25
    assert far[wrong, 0, 1].any()
    for named, plane in zip((got.xy_img, got.score, got.sigma_px, got.depth_m), true, strict=True):
        assert np.array_equal(named[far][:, legs], plane[far][:, legs])


def test_a_view_is_no_swapped_one_where_only_one_of_its_limbs_fits_better(ring_rig) -> None:
    """Two of four cameras see one arm only and name both after it. With the left arm taken to be there, too, the raised one of
    the other two fits neither side: which of the two it misses by less is chance, and no reason to name its right arm left."""
    rig, rng = ring_rig(4), np.random.default_rng(3)
    true = np.tile(standing(), (T, 1, 1, 1))
    true[..., LEFT_ARM[1:], :] = true[..., LEFT_ARM[:1], :] + [[0.1, 0.25, 0.1], [0.1, 0.3, 0.4]]
    doubled = np.array(true)
    doubled[..., LEFT_ARM, :] = true[..., COCO17.mirror[LEFT_ARM], :]
    seen = np.stack([camera.project((doubled, true)[c % 2]) for c, camera in enumerate(rig)], axis=2)
    seen += 2 * rng.normal(size=seen.shape)
    wrong = poses(doubled + 0.03 * rng.normal(size=doubled.shape), rate_hz=30.0)
    for reference in (wrong, poses(true, rate_hz=30.0)):
        named = sides_like(reference, rig, view_sequence(rig, reference, seen, sigma_px=2.0))
        np.testing.assert_array_equal(named.xy_img[:, :, 1::2], seen[:, :, 1::2])


def test_a_limb_is_not_swapped_with_one_that_the_reference_lacks(ring_rig) -> None:
    """What is not known is no better place for a leg than one that this view misses."""
    rig, reference = ring_rig(3), walkers()
    seen = np.array(noisy_views(rig, reference, 0.0, 0).xy_img)
    seen[:, 0, 1, LEFT_LEG] += 40.0
    xyz = np.array(reference.xyz_world)
    xyz[:, 0, RIGHT_LEG] = np.nan
    named = sides_like(replace(reference, xyz_world=xyz), rig, view_sequence(rig, reference, seen, sigma_px=2.0))
    np.testing.assert_array_equal(named.xy_img, seen)


def test_missing_views_stay_missing(ring_rig) -> None:
    rig, reference = ring_rig(3), walkers()
    named = sides_like(reference, rig, view_sequence(rig, reference, np.full((T, N, 3, K, 2), np.nan)))
    assert np.isnan(named.xy_img).all()
    assert (named.score == 0).all()
    assert np.isnan(named.sigma_px).all()
    assert named.depth_m is None


def test_legs_are_on_the_side_of_the_body_that_the_shoulders_show_even_against_the_majority() -> None:
    clean = walkers()
    confused = swapped(clean, slice(20, T), 0, LEFT_LEG)
    assert same(steady_sides(confused, NOTHING), clean)
    # without shoulders the majority is right
    majority = swapped(confused, slice(0, 20), 0, LEFT_LEG)
    before, after = (unseen(one, "left_shoulder", "right_shoulder") for one in (confused, majority))
    assert same(steady_sides(before, NOTHING), after)


def facing(part: int, count: int, time_steps: slice = slice(None)) -> np.ndarray:
    """Clues of person 0 only."""
    clues = np.array(NOTHING)
    clues[part, time_steps, 0] = count
    return clues


@pytest.mark.parametrize("part", [0, 1], ids=["arms", "legs"])
def test_clues_to_where_the_body_faces_decide_where_motion_cannot(part: int) -> None:
    clean, limb = walkers(), [LEFT_ARM, LEFT_LEG][part]
    xyz = np.array(clean.xyz_world)
    # out of sight, so that nothing connects what came before with what came after; nor do the shoulders of the others
    xyz[20:24, 0] = np.nan
    xyz[:, 0, np.setdiff1d(np.arange(K), [*limb, *COCO17.mirror[limb]])] = np.nan
    clean = replace(clean, xyz_world=xyz)
    confused = swapped(clean, slice(0, 20), 0, limb)
    assert same(steady_sides(confused, NOTHING), confused)
    assert same(steady_sides(confused, facing(part, -1, slice(0, 20))), confused), "one clue is not enough"
    against = facing(part, -2, slice(0, 20)) + facing(part, 2, slice(24, T))
    assert same(steady_sides(confused, against), clean)
    # of a whole recording, too
    confused = swapped(clean, slice(0, T), 0, limb)
    assert same(steady_sides(confused, facing(part, -2)), clean)
