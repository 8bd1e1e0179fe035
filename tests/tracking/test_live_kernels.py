"""The live tracker in parts: its kernels one at a time, depth, and what is learnt from a person's own motion."""

from dataclasses import replace

import numpy as np
import pytest

from posefuse.core import Skeleton
from posefuse.core.depth import keypoint_depth
from posefuse.core.skeleton import ANATOMICAL23, COCO17
from posefuse.tracking.online import LiveMotion, LiveSettings, Model, MotionModel
from posefuse.tracking.online.kernels.body import start_missing
from posefuse.tracking.online.kernels.rays import depth_row, swap_person
from posefuse.tracking.online.kernels.state import NEVER, KeypointRays, TrackState, unborn
from posefuse.tracking.online.kernels.updates import update
from posefuse.tracking.online.own_motion import HORIZON_S, OwnMotion
from posefuse.tracking.online.person import named_rays
from posefuse.tracking.smooth_kernels import inverse3


def test_a_missing_keypoint_starts_at_the_mean_of_its_neighbours_and_moves_with_them(ring_rig) -> None:
    """The last of three keypoints is tied to both others."""
    skeleton = Skeleton("chain", ("one", "two", "middle"), bones=(("one", "middle"), ("two", "middle")))
    motion = LiveMotion(keypoints=(MotionModel(3.0, 0.1),), body=(MotionModel(1.0, 0.1),))
    session = Model(ring_rig(2), skeleton, LiveSettings(), motion).arrays
    person = unborn(session)
    person.x[:], person.cov[:] = np.nan, np.nan
    person.x[0, 0], person.x[1, 0] = np.arange(9.0), np.arange(9.0) + [2, 4, 6, 1, 1, 1, 0, 0, 0]
    person.seen[:2], person.seen[2] = 1.0, NEVER
    start_missing(person, np.zeros((3, 2)), 1.0, session)
    np.testing.assert_allclose(person.x[2, 0], [1, 3, 5, 3.5, 4.5, 5.5, 0, 0, 0])
    sigma = np.sqrt(person.cov[2, 0].diagonal())
    assert (sigma[:6] > 0).all()
    np.testing.assert_allclose(sigma[6:], 3.0)


def test_swapped_twice_a_person_is_as_before_and_once_every_part_is_on_the_other_side(ring_rig) -> None:
    session = Model(ring_rig(2), ANATOMICAL23, LiveSettings()).arrays
    rng = np.random.default_rng(1)
    person = TrackState(*(rng.normal(size=plane.shape) for plane in unborn(session)))
    before = person.copy()
    arms = np.flatnonzero(session.group == 0)
    swap_person(person, session, 0)
    for name in ("x", "cov", "share", "lively", "seen", "square", "precision", "deepness"):
        here, was = getattr(person, name), getattr(before, name)
        np.testing.assert_array_equal(here[arms], was[session.mirror[arms]], err_msg=name)
        others = np.setdiff1d(np.arange(len(here)), arms)
        np.testing.assert_array_equal(here[others], was[others], err_msg=name)
    swap_person(person, session, 0)
    for here, was in zip(person, before, strict=True):
        np.testing.assert_array_equal(here, was)


def test_a_view_that_swaps_a_limb_is_put_in_order(ring_rig) -> None:
    """Arms are swapped by the view, legs are not; one keypoint is missing."""
    model, rng = Model(ring_rig(2), ANATOMICAL23, LiveSettings()), np.random.default_rng(0)
    k, camera = len(ANATOMICAL23), model.rig.cameras[1].cam_from_world
    xyz = rng.normal(0, 0.5, (k, 3)) + [0.0, 0.0, 1.0]
    there = xyz @ camera.matrix().T + camera.xyz
    ideal = there[:, :2] / there[:, 2:]
    order = np.where(model.arrays.group == 0, model.skeleton.mirror, np.arange(k))
    seen, hidden = ideal[order], int(np.flatnonzero(model.arrays.group == 1)[0])
    seen[hidden] = np.nan
    sigma = rng.uniform(0.001, 0.003, k)
    white = np.eye(2) / sigma[order, None, None]
    rays = KeypointRays(camera=1, z=seen, white=white, late_s=rng.uniform(0, 0.01, k), sigma_px=np.ones(k))
    z, inverse_var = named_rays(rays, xyz, model)
    known = np.arange(k) != hidden
    np.testing.assert_allclose(z[known], ideal[known])
    np.testing.assert_allclose(inverse_var[known], sigma[known] ** -2.0)
    assert np.isnan(z[hidden]).all() and inverse_var[hidden] == 0


# --- small compiled matrices


@pytest.mark.parametrize("seed", range(5))
def test_the_inverse_is_numpys_and_of_a_symmetric_matrix_symmetric(seed: int) -> None:
    any_matrix = np.random.default_rng(seed).normal(size=(3, 3))
    for matrix in (any_matrix, any_matrix @ any_matrix.T):
        out = np.empty((3, 3))
        assert inverse3(matrix, out) == pytest.approx(np.linalg.det(matrix))
        np.testing.assert_allclose(out @ matrix, np.eye(3), atol=1e-9)
    np.testing.assert_array_equal(out, out.T)


# --- depth: one camera is enough, and no depth may pull a person out of what other views agree on


SIGMA_M = 0.02
LATE_NS = 30_000_000


def with_depth(world, view, rng, sigma_m=SIGMA_M, before_m=0.0):
    """The view with the depth of the surface of every keypoint, `before_m` in front of the person."""
    camera = world.rig[view.camera]
    z = (camera.cam_from_world @ world.place(view.t_ns / 1e9))[:, 2]
    norm = camera.norm_from_px(view.xy_img[0])
    below = keypoint_depth(np.stack([z, np.zeros(len(z))], axis=-1), norm, COCO17)
    # the surface of this person is where the table says, give or take what it says
    depth = z - (below[:, 0] - z) + rng.normal(size=len(z)) * np.hypot(sigma_m, below[:, 1]) - before_m
    return replace(view, depth_m=np.stack([depth, np.full(len(z), sigma_m)], axis=-1)[None])


def followed(world, views, seconds):
    """(errors (F, K) in m, squared Mahalanobis distances (F, K)) of what the tracker says at each view's time."""
    tracker = world.tracker()
    errors, squares = [], []
    for view in views:
        tracker.add(view)
        pose = tracker.at(view.t_ns + LATE_NS)
        if view.t_ns > seconds * 1e9 and len(pose.person_id):
            miss = pose.xyz_world[0] - world.place(pose.t_ns / 1e9)
            errors.append(np.linalg.norm(miss, axis=-1))
            squares.append(np.einsum("ki,kij,kj->k", miss, np.linalg.inv(pose.cov_world[0]), miss))
    return np.array(errors), np.array(squares)


def test_one_camera_with_depth_follows_a_walker_within_its_sigma(world):
    alone, rng = world(1), np.random.default_rng(0)
    plain = alone.views(2.5)
    assert not len(alone.fed(plain).at(plain[-1].t_ns).person_id)
    errors, squares = followed(alone, [with_depth(alone, view, rng) for view in plain], 0.5)
    assert len(errors) > 50
    assert np.median(errors) < 0.04
    assert 1.0 < squares.mean() < 6.0


def test_depth_makes_two_cameras_side_by_side_better(world):
    near = world(16)
    near = replace(near, rig=type(near.rig)(near.rig.cameras[:2]))
    rng, plain = np.random.default_rng(0), near.views(2.5)
    without, _ = followed(near, plain, 0.7)
    better, _ = followed(near, [with_depth(near, view, rng) for view in plain], 0.7)
    assert np.sqrt((better**2).mean()) < 0.8 * np.sqrt((without**2).mean())


def test_what_stands_in_front_of_one_camera_does_not_pull_the_person(world):
    four, rng = world(4), np.random.default_rng(0)
    plain = four.views(2.0)
    without, _ = followed(four, plain, 0.5)
    occluded = [with_depth(four, view, rng, before_m=1.0) if view.camera == four.rig.names[1] else view for view in plain]
    errors, _ = followed(four, occluded, 0.5)
    assert len(errors) == len(without)
    assert np.sqrt((errors**2).mean()) < 1.1 * np.sqrt((without**2).mean())


def test_a_camera_alone_is_left_to_its_depth(world):
    """The others are lost after a second: without depth the person is dropped, with it followed to the end."""
    four, rng = world(4), np.random.default_rng(0)
    views = [view for view in four.views(4.0) if view.camera == four.rig.names[0] or view.t_ns < 1e9]
    without, deep = (four.fed(some).at(views[-1].t_ns) for some in (views, [with_depth(four, view, rng) for view in views]))
    assert not len(without.person_id)
    assert np.median(four.error_m(deep)) < 0.08


def test_the_row_of_depth_is_its_derivative(ring_rig):
    rig = ring_rig(1)
    camera = Model(rig, COCO17, LiveSettings()).arrays.cameras[0]
    point, measured, row, scratch = np.array([0.3, -0.2, 1.1]), np.array([3.0, 0.05]), np.empty(3), np.empty(3)
    error = depth_row(camera, point, measured, row)
    assert error == pytest.approx((3.0 - (rig.cameras[0].cam_from_world @ point)[2]) / 0.05)
    steps = [depth_row(camera, point + step, measured, scratch) for step in np.eye(3) * 1e-6]
    np.testing.assert_allclose(row, -(np.array(steps) - error) / 1e-6, rtol=1e-5)


def test_an_update_by_depth_is_that_of_a_kalman_filter(ring_rig):
    rules = Model(ring_rig(1), COCO17, LiveSettings()).arrays.rules
    rng = np.random.default_rng(2)
    root = rng.normal(size=(9, 9))
    cov, common = (root @ root.T)[None], np.eye(3) * 0.3
    x, row = rng.normal(size=(1, 9)), np.array([1.0, -2.0, 0.5])
    rows, away = np.array([row, np.zeros(3)]), np.array([[0.7, 0.0]])
    long_row = np.concatenate([row, np.zeros(6)])
    s = row @ (cov[0, :3, :3] + common) @ row + 1
    gain = cov[0] @ long_row / s
    wanted_x, wanted_cov = x[0] + gain * 0.7, cov[0] - np.outer(gain, gain) * s
    assert update(x, cov, np.ones(1), rows, away, common, 1.0, rules) == pytest.approx(0.7**2 / s)
    np.testing.assert_allclose(x[0], wanted_x)
    np.testing.assert_allclose(cov[0], wanted_cov, atol=1e-12)
    # far beyond the gate nothing changes
    assert update(x, cov, np.ones(1), rows, np.array([[1e4, 0.0]]), common, 1.0, rules) > rules.gate_chi2
    np.testing.assert_allclose(x[0], wanted_x)


# --- what predictions of a person's motion miss is learnt from that motion; of another person nothing is known


HANDS = Skeleton("hands", ("left_wrist", "right_wrist"))
OLD_NS = 100_000_000
SECONDS = 6.0
ARMS = [COCO17.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("elbow", "wrist")]


def swinging(standing):
    """The arms of a standing person swing forward and backward, as a pendulum does."""

    def at(t_s):
        xyz = standing.copy()
        xyz[ARMS] += np.array([0.25, 0.1, 0.05]) * np.sin(2 * np.pi * 1.1 * t_s)
        return xyz

    return at


@pytest.fixture
def standing(world):
    return world(motion="stand").place(0.0)


def errors_of(w, seed=0):
    """(T,) times in s and (T, K) errors in m of poses that come out when their views are `OLD_NS` old."""
    tracker, times, errors = w.tracker(), [], []
    for view in w.views(SECONDS, seed=seed):
        tracker.add(view)
        pose = tracker.at(view.t_ns + OLD_NS)
        if len(pose.person_id):
            times.append(pose.t_ns * 1e-9)
            errors.append(w.error_m(pose))
    return np.array(times), np.array(errors)


def test_a_movement_that_is_repeated_is_predicted_better_and_better(world, standing):
    t_s, error = errors_of(world(motion=swinging(standing)))
    arms = error[:, ARMS].mean(axis=1)
    # a whole swing takes 0.9 s; the first corrections come 0.6 s after the person
    first, last = arms[t_s < 0.7].mean(), arms[t_s > SECONDS - 1.8].mean()
    assert last < 0.75 * first


def test_a_person_who_stands_is_not_moved(world):
    """Nothing can be learnt of noise: the error stays what it was before anything was learnt."""
    t_s, error = errors_of(world(motion="stand"))
    before, after = error[(t_s > 0.4) & (t_s < 0.8)].mean(), error[t_s > 2.0].mean()
    assert after < 1.1 * before


def test_a_movement_that_ends_is_soon_not_expected_any_more(world, standing):
    """The arms swing until 3 s and are still from then on: soon no worse than a person who never moved."""
    swing = swinging(standing)
    quiet_s = 3.0 + 1.5
    t_s, error = errors_of(world(motion=lambda t: swing(min(t, 3.0))))
    t_still, still = errors_of(world(motion=lambda t: swing(3.0)))
    assert error[t_s > quiet_s].mean() < 1.15 * still[t_still > quiet_s].mean()


def test_without_hips_nothing_is_corrected():
    own, places = OwnMotion(HANDS), np.ones((len(HANDS), 3))
    own.settle(0, places, places)
    assert own.waits_until_ns() is None
    assert own.correction(places, places, HORIZON_S) == 0.0


def test_a_correction_grows_with_time_up_to_its_limits_and_counts_as_far_as_it_was_right(standing):
    """Every prediction misses the same: the wrists are elsewhere by 5 cm, and the nose by 30 cm, which is no motion."""
    own, wrists, nose = OwnMotion(COCO17), COCO17.indices(("left_wrist", "right_wrist")), COCO17.index("nose")
    seen = standing.copy()
    seen[wrists] += (0.03, 0.0, 0.04)
    seen[nose] += (0.3, 0.0, 0.0)

    def correction_m(since_s):
        return own.correction(standing, standing, since_s)

    for n in range(200):
        assert n > 0 or not correction_m(HORIZON_S).any(), "nothing is known at first"
        own.settle(25_000_000 * n, standing, standing)
        own.judge(seen)
    after = correction_m(HORIZON_S)
    np.testing.assert_allclose(after[wrists], [(0.03, 0.0, 0.04)] * 2, rtol=0.05)
    assert np.abs(np.delete(after, wrists, axis=0)).max() < 1e-9
    np.testing.assert_allclose(correction_m(HORIZON_S / 2), after / 2)
    np.testing.assert_allclose(correction_m(10.0), correction_m(0.15))
    for n in range(40):
        own.settle(25_000_000 * n, standing, standing)
        own.judge(standing)
    # a second later the sums of the tests show that such corrections are wrong now
    assert np.abs(correction_m(HORIZON_S)).max() < 0.2 * np.abs(after).max()
