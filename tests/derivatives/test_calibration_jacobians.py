"""Jacobians of the calibration solvers against finite differences."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bench.faults.waved_props import Faults, Waving, cube, observe_prop
from posefuse.calibration.bundle import grouped_sum
from posefuse.calibration.extrinsics.pipeline import Options, RigTask, key_snapshots, link, solve
from posefuse.calibration.extrinsics.prop_solve import Freedom, PropState, _PropProblem
from posefuse.calibration.geometry import Lenses, Poses, poses_of, stacked
from posefuse.calibration.targets.kinds import Markers, patch_corners
from posefuse.core import Rig

STEP = 1e-6


def test_every_block_of_the_prop_solve(ring_rig: Callable[..., Rig]) -> None:
    rig, target = ring_rig(3, distortion=(-0.12, 0.05, 0.001, -0.0005, 0.01)), Markers(0.24)
    waved = observe_prop(rig, cube(0.3), target, Waving(seconds=4), Faults())
    task = RigTask(waved, rig.cameras, target, Options(time_steps=8))
    seen = key_snapshots(task, np.zeros((3, 2)))
    links = link(task, seen)
    patches = len(seen.patches)
    poses = [links.shape.prop_from_patch.get(i, Poses(np.eye(3), np.zeros(3))) for i in range(patches)]
    random = np.random.default_rng(0)
    world = Waving(seconds=4).pose(seen.t_s + 2)
    cameras = poses_of(rig)
    state = PropState(cameras, Poses.from_se3(world), stacked(poses), np.zeros((3, 2)), random.normal(0, 1e-3, (3, 6)))
    freedom = Freedom(reference=0, held_patches=(0,), offset=True, drift=True, lens_sigma=np.ones(6))
    corners = patch_corners(target, seen.patches)
    model = _PropProblem(seen, corners, rig.cameras, state, freedom, sigma_px=0.5, cauchy=1.0)
    linear = model.linearise(state)
    zeros = [np.zeros((block.count, block.jacobian.shape[2])) for block in linear.blocks]
    nothing = np.zeros((len(seen.t_s), 6))
    for b, block in enumerate(linear.blocks):
        for p in range(block.jacobian.shape[2]):
            steps = [z.copy() for z in zeros]
            steps[b][:, p] = STEP
            forward = model.residual(model.step(state, steps, nothing))
            steps[b][:, p] = -STEP
            change = (forward - model.residual(model.step(state, steps, nothing))) / (2 * STEP)
            np.testing.assert_allclose(block.jacobian[:, :, p], change, rtol=2e-5, atol=2e-4)
    for p in range(6):
        step = nothing.copy()
        step[:, p] = STEP
        change = (model.residual(model.step(state, zeros, step)) - model.residual(model.step(state, zeros, -step))) / (2 * STEP)
        np.testing.assert_allclose(linear.local_jacobian[:, :, p], change, rtol=2e-5, atol=2e-4)


def test_pixels_of_lenses_are_those_of_the_shared_camera_model(ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(2, distortion=(-0.12, 0.05, 0.001, -0.0005, 0.01))
    points = np.random.default_rng(1).uniform(-0.8, 0.8, (40, 3)) + [0, 0, 1]
    which = np.arange(40) % 2
    in_cam = np.stack([rig.cameras[c].cam_from_world @ xyz for c, xyz in zip(which, points, strict=True)])
    px, jacobian = Lenses(rig.cameras).px(which, in_cam), Lenses(rig.cameras).px_jacobian(which, in_cam)
    np.testing.assert_allclose(px, [rig.cameras[c].project(xyz) for c, xyz in zip(which, points, strict=True)], atol=1e-9)
    for axis in range(3):
        step = np.eye(3)[axis] * STEP
        change = (Lenses(rig.cameras).px(which, in_cam + step) - Lenses(rig.cameras).px(which, in_cam - step)) / (2 * STEP)
        np.testing.assert_allclose(jacobian[:, :, axis], change, rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("pinhole", (-0.12, 0.05, 0.001, -0.0005, 0.01)),
        ("pinhole", (-0.12, 0.05, 0.001, -0.0005, 0.01, 0.1, 0.02, 0.0)),
        ("fisheye", (0.03, -0.01, 0.002, 0.0)),
    ],
    ids=["brown", "rational", "fisheye"],
)
def test_pixels_change_with_the_lens_as_said(ring_rig: Callable[..., Rig], model: str, distortion: tuple[float, ...]) -> None:
    camera = replace(ring_rig(1).cameras[0], model=model, distortion=np.array(distortion))
    points, which = np.array([[0.8, 0.5, 1.0], [0.1, 0.2, 1.0], [1.5, 1.0, 1.0]]), np.zeros(3, np.int64)
    jacobian = Lenses((camera,)).lens_jacobian(which, points)
    for p, step in enumerate(np.eye(6) * 1e-5):
        px = [Lenses((camera,), delta[None]).px(which, points) for delta in (step, -step)]
        np.testing.assert_allclose(jacobian[:, :, p], (px[0] - px[1]) / 2e-5, rtol=1e-5, atol=1e-5)


def test_refined_fisheye_lenses_are_as_uncertain_as_stated(ring_rig: Callable[..., Rig]) -> None:
    """Mean square of errors in standard errors, which is 1; the given lenses deviate by their own standard errors."""
    random, ratios, prior = np.random.default_rng(5), [], np.array([3.0, 3.0, 2.0, 2.0, 0.02, 0.01])
    flat = ring_rig(3, radius_m=2.5)
    wide = np.array([[260.0, 0, 319.5], [0, 260.0, 239.5], [0, 0, 1]])
    rig = Rig(tuple(replace(c, K=wide, model="fisheye", distortion=np.array([0.03, -0.01, 0.002, 0.0])) for c in flat))
    target, options, nothing = Markers(0.24), Options(time_steps=40, clocks="together", lens_sigma=tuple(prior)), np.zeros((3, 2))
    for seed in range(3):
        seen = observe_prop(rig, cube(0.3), target, Waving(seconds=12, rate_hz=10, seed=seed), Faults(missed=0.0, seed=seed))
        off = random.normal(0, prior, (3, 6))
        lenses = Lenses(rig.cameras, off)
        given = tuple(replace(c, K=lenses.camera_matrix(i), distortion=lenses.distortion(i)) for i, c in enumerate(rig))
        found = solve(RigTask(seen, given, target, options), nothing).solution
        ratios.append((found.state.lens_delta + off) / np.sqrt(np.diagonal(found.lens_covariance, axis1=1, axis2=2)))
    assert 0.5 < float((np.array(ratios) ** 2).mean()) < 1.6


def test_grouped_sums() -> None:
    values = np.arange(30.0).reshape(5, 2, 3)
    index = np.array([2, 0, 2, 1, 0])
    want = np.stack([values[index == i].sum(axis=0) for i in range(4)])
    np.testing.assert_allclose(grouped_sum(values, index, 4), want)
