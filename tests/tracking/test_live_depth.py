"""Depth in live tracking: one camera is enough, and no depth may pull a person out of what other views agree on."""

from dataclasses import replace

import numpy as np
import pytest

from posefuse.core.depth import keypoint_depth
from posefuse.core.skeleton import COCO17
from posefuse.tracking.online import LiveSettings
from posefuse.tracking.online.kernels.rays import depth_row, expected_depth
from posefuse.tracking.online.kernels.updates import update_depth
from posefuse.tracking.online.person import Model

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
    camera = Model.cameras.func(type("One", (), {"rig": rig})())[0]
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
    x, row, away = rng.normal(size=(1, 9)), np.array([1.0, -2.0, 0.5]), np.array([0.7])
    long_row = np.concatenate([row, np.zeros(6)])
    s = row @ (cov[0, :3, :3] + common) @ row + 1
    assert expected_depth(row, cov[0, :3, :3] + common) == pytest.approx(s)
    gain = cov[0] @ long_row / s
    wanted_x, wanted_cov = x[0] + gain * 0.7, cov[0] - np.outer(gain, gain) * s
    assert update_depth(x, cov, np.ones(1), row, away, common, rules)
    np.testing.assert_allclose(x[0], wanted_x)
    np.testing.assert_allclose(cov[0], wanted_cov, atol=1e-12)
    # far beyond the gate nothing changes
    assert not update_depth(x, cov, np.ones(1), row, np.array([1e4]), common, rules)
    np.testing.assert_allclose(x[0], wanted_x)
