import numpy as np
import pytest
from built import camera

from posefuse.core import SE3, Rig
from posefuse.core.lens import slopes
from posefuse.core.rig import packed_rig
from posefuse.fusion.kernels import point
from posefuse.fusion.triangulation import whitened

K = np.array([[700.0, 3.0, 320.0], [0, 690.0, 240.0], [0, 0, 1]])
POSE = SE3.from_rotvec([0.1, -0.2, 0.3], [0.1, 0.2, 3.0])
BROWN = [-0.2, 0.05, 0.001, -0.002, 0.01, 0.02, -0.01, 0.005, 0.001, -0.002, 0.003, -0.001, 0.02, -0.03]
CAMERAS = [camera(K, BROWN[:n], POSE, name=f"c{n}") for n in (0, 4, 5, 8, 12, 14)]
CAMERAS += [camera(K, [-0.03, 0.01, -0.004, 0.001], POSE, name="fish", model="fisheye")]
POINTS = np.random.default_rng(0).uniform(-0.35, 0.35, (11, 2))


@pytest.mark.parametrize("seen_by", CAMERAS, ids=lambda c: c.name)
def test_lens_derivatives(seen_by):
    step, points = 1e-6, np.concatenate([POINTS, np.zeros((1, 2))])
    ahead, behind = ([seen_by.px_from_norm(points + sign * one) for one in step * np.eye(2)] for sign in (1, -1))
    numeric = np.stack([(a - b) / (2 * step) for a, b in zip(ahead, behind, strict=True)], axis=-1)
    found = seen_by.K[:2, :2] @ slopes(points, seen_by.distortion, seen_by.model)
    np.testing.assert_allclose(found, numeric, rtol=1e-6, atol=1e-5)


def looked(rig: Rig, xy: np.ndarray, sigma: float) -> np.ndarray:
    views, (ideal, white) = np.empty((len(rig), 7)), whitened(rig, xy[None, :, None], np.full((1, len(rig), 1), sigma))
    for c in range(len(rig)):
        assert point.look(ideal[0, c, 0], white[0, c, 0], 1.0, c, views, c)
    return views


TRUTH = np.array([0.3, -0.2, 1.2])


@pytest.fixture(scope="module")
def rig(ring_rig):
    return ring_rig(4, distortion=(-0.2, 0.05, 0.001, -0.002))


def systems(rig, views, step_m, *planes):
    """What `normal_system` makes of the views at TRUTH, and the derivatives of half the loss (3,) and of its gradient (3, 3)."""
    cams, system, ahead, behind = packed_rig(rig), np.empty(9), np.empty(9), np.empty(9)
    point.normal_system(cams, views, 4, TRUTH, system, *planes)
    gradient, information = np.empty(3), np.empty((3, 3))
    for i, step in enumerate(np.eye(3) * step_m):
        more = point.normal_system(cams, views, 4, TRUTH + step, ahead, *planes)
        less = point.normal_system(cams, views, 4, TRUTH - step, behind, *planes)
        gradient[i], information[i] = (more - less) / (4 * step_m), (ahead[6:] - behind[6:]) / (2 * step_m)
    return system, gradient, information


@pytest.mark.parametrize("sigma", [50.0, 1.0])
def test_gradient_of_the_robust_loss(rig, sigma):
    """Half the gradient of the loss, in its quadratic (large sigma) and its bounded part (small sigma)."""
    views = looked(rig, rig.project(TRUTH) + np.random.default_rng(1).normal(size=(4, 2)) * 8, sigma)
    system, gradient, _ = systems(rig, views, 1e-6)
    np.testing.assert_allclose(system[6:], gradient, rtol=1e-5)


@pytest.mark.parametrize("sigma_m", [1.0, 0.01], ids=["quadratic", "bounded"])
def test_gradient_and_information_of_depth(rig, sigma_m):
    """Of the rows of depth alone: those of the rays have next to no weight."""
    views = looked(rig, rig.project(TRUTH), 1e9)
    depth = np.array([(one.cam_from_world @ TRUTH)[2] for one in rig]) + [0.1, -0.07, 0.0, 0.05]
    planes = np.stack([depth, [1 / sigma_m, 2 / sigma_m, 0.0, 1 / sigma_m]], axis=1)
    system, gradient, information = systems(rig, views, 1e-6, planes)
    np.testing.assert_allclose(system[6:], gradient, rtol=1e-5, atol=1e-7)
    if sigma_m == 1.0:
        np.testing.assert_allclose(system[:6], information[np.triu_indices(3)], rtol=1e-5, atol=1e-7)


def test_information_is_the_second_derivative_where_residuals_vanish(rig):
    system, _, information = systems(rig, looked(rig, rig.project(TRUTH), 2.0), 1e-5)
    np.testing.assert_allclose(system[:6], information[np.triu_indices(3)], rtol=1e-5, atol=1e-3)
