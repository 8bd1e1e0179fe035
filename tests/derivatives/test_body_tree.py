"""The tree's Jacobians and manifold operations against finite differences and scipy."""

import numpy as np
import pytest
from figure import BENT, sequence_of
from scipy.spatial.transform import Rotation

from posefuse.core import SKELETONS
from posefuse.kinematics import JOINT_NAMES, JointSettings
from posefuse.kinematics.body import fit_kernels, tree_kernels
from posefuse.kinematics.definitions import POINTS, landmark_pairs
from posefuse.kinematics.joints import FrameBuffers
from posefuse.kinematics.kernels import MEMORY_SIZE

BALL, HINGE, SLIDE = tree_kernels.BALL, tree_kernels.HINGE, tree_kernels.SLIDE
TREE = tree_kernels.Tree(
    parent=np.array([-1, 0, 1, 2, 1]),
    kind=np.array([SLIDE, BALL, HINGE, SLIDE, HINGE]),
    axis=np.array([1, 0, 2, 0, 1]),
    offset=np.zeros((5, 3)),
    dof=np.array([0, 1, 4, 5, 6, 7]),
    limits=np.tile([1.0, 0.0], (5, 3, 1)),
    mirrored=np.zeros(5, bool),
    node=np.array([3, 4]),
    local=np.zeros((2, 3)),
    preferred_sd=np.full(5, np.inf),
    slack_var=np.array([0, 0, 0, 0, 0, 0.04, 0]),
    accel=np.zeros(7),
)


@pytest.fixture
def state():
    rng = np.random.default_rng(8)
    q = rng.normal(size=5) * 0.6
    rot = Rotation.from_rotvec(rng.normal(size=(5, 3))).as_matrix()
    return q, rot, rng.normal(size=(5, 3)), rng.normal(size=(2, 3))


def places(q, rot, offset, local):
    frame, origin = np.empty((5, 3, 3)), np.empty((5, 3))
    tree_kernels.forward_kinematics(TREE._replace(offset=offset), q, rot, frame, origin)
    return np.stack([tree_kernels.place(frame, origin, node, local[i]) for i, node in enumerate((3, 4))]), frame, origin


def moved(step, q, rot):
    q, rot = q.copy(), rot.copy()
    tree_kernels.retract(TREE, step, q, rot)
    return q, rot


def test_point_derivatives_equal_finite_differences(state):
    q, rot, offset, local = state
    points, frame, origin = places(q, rot, offset, local)
    for p, node in enumerate((3, 4)):
        columns, values = np.empty(7, np.int64), np.empty((7, 3))
        count = tree_kernels.derivative(TREE, frame, node, points[p], origin, columns, values)
        dense = np.zeros((7, 3))
        dense[columns[:count]] = values[:count]
        for d in range(7):
            step = np.eye(7)[d] * 1e-6
            ahead, back = (places(*moved(sign * step, q, rot), offset, local)[0][p] for sign in (1, -1))
            np.testing.assert_allclose(dense[d], (ahead - back) / 2e-6, atol=1e-8)


def test_exponential_and_logarithm_agree_with_scipy():
    rng = np.random.default_rng(3)
    for scale in (1e-9, 1e-4, 0.5, 3.0):
        v = rng.normal(size=3)
        v *= scale / np.linalg.norm(v)
        r = tree_kernels.exp3(v)
        np.testing.assert_allclose(r, Rotation.from_rotvec(v).as_matrix(), atol=1e-12)
        np.testing.assert_allclose(tree_kernels.log3(r), v, rtol=1e-6, atol=1e-12)


def test_a_half_turn_has_a_logarithm():
    half = Rotation.from_rotvec(np.pi * np.array([0.6, 0.0, -0.8])).as_matrix()
    np.testing.assert_allclose(Rotation.from_rotvec(tree_kernels.log3(half)).as_matrix(), half, atol=1e-7)


def test_difference_undoes_retract(state):
    q, rot, _, _ = state
    step = np.random.default_rng(5).normal(size=7) * 0.5
    np.testing.assert_allclose(tree_kernels.difference(TREE, *moved(step, q, rot), q, rot), step, atol=1e-10)


def test_ray_gradient_is_that_of_the_robust_cost():
    rng = np.random.default_rng(6)
    projections = rng.normal(size=(3, 3, 4))
    projections[:, 2] = [0.1, 0.05, 0.02, 4.0]
    x, xy, inverse_var, robust = rng.normal(size=3), rng.normal(size=(3, 2)), np.array([2.0, 0.0, 5.0]), 4.0

    def cost(x):
        total = 0.0
        for c in range(3):
            u, v, w = projections[c] @ [*x, 1.0]
            squared = ((xy[c] - np.array([u, v]) / w) ** 2).sum() * inverse_var[c]
            total += (robust + 2) / 2 * np.log1p(squared / robust)
        return total

    gradient, information = np.zeros(3), np.zeros((3, 3))
    fit_kernels.ray_information(x, projections, xy, inverse_var, robust, gradient, information)
    numeric = [(cost(x + h) - cost(x - h)) / 2e-6 for h in np.eye(3) * 1e-6]
    np.testing.assert_allclose(-gradient, numeric, rtol=1e-6)
    assert (np.linalg.eigvalsh(information) > 0).all()


def test_predict_spreads_the_covariance_by_its_transition(state):
    q, rot, _, _ = state
    rng = np.random.default_rng(7)
    cov = rng.normal(size=(14, 14))
    cov = cov @ cov.T
    before, velocity = cov.copy(), rng.normal(size=7)
    keep, drift, fade = fit_kernels.predict(TREE, 0.02, 0.3, 0.5, q.copy(), rot.copy(), velocity, cov)
    transition = np.block([[np.diag(keep), np.diag(drift)], [np.zeros((7, 7)), np.diag(fade)]])
    expected = transition @ before @ transition.T
    expected[5, 5] += 0.04 * (1 - keep[5] ** 2)
    expected[12, 12] = 1e-12
    np.testing.assert_allclose(cov, expected, atol=1e-10)


def test_dense_algebra_agrees_with_numpy():
    rng = np.random.default_rng(9)
    a, b = rng.normal(size=(7, 7)), rng.normal(size=(4, 7))
    spd = a @ a.T + np.eye(7)
    np.testing.assert_allclose(tree_kernels.solve_rows(spd, b), np.linalg.solve(spd, b.T).T, rtol=1e-10)
    np.testing.assert_allclose(tree_kernels.inverse(spd), np.linalg.inv(spd), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(tree_kernels.times_transposed(b, a), b @ a.T, rtol=1e-12)


# --- what moves an angle, in closed form, against finite differences of the angles themselves


SKELETON = SKELETONS["blazepose33"]
STEP_M = 1e-6


@pytest.fixture(scope="module")
def keypoints():
    """A person askew, every limb bent, every coordinate different."""
    bent = sequence_of([BENT]).xyz_world[0, 0]
    return bent + np.random.default_rng(11).normal(size=bent.shape) * 0.02


def solved(xyz):
    """Angles (J, 3) and weights (J, P, 3, 3), limbs turned by their own planes of this time step."""
    work = FrameBuffers(SKELETON, JointSettings(hinge_play_rad=0.0))
    # points this exact leave the plane guessed from the parent no say
    work.read(xyz, np.broadcast_to(np.eye(3) * 1e-16, (len(xyz), 3, 3)))
    memory = np.full((4, MEMORY_SIZE), np.nan)
    work.step_planes(memory, 1.0)
    work.solve(work.updated)
    return work.angles.copy(), work.weights.copy()


@pytest.mark.parametrize("point", POINTS)
def test_weights_are_the_derivatives_of_the_angles(keypoints, point):
    _, weights = solved(keypoints)
    index = POINTS.index(point)
    keypoint = landmark_pairs(SKELETON)[index, 0]
    for axis in range(3):
        ahead, back = keypoints.copy(), keypoints.copy()
        ahead[keypoint, axis] += STEP_M
        back[keypoint, axis] -= STEP_M
        numeric = (solved(ahead)[0] - solved(back)[0]) / (2 * STEP_M)
        defined = np.isfinite(numeric)
        assert defined.sum() >= 40
        for q, a in np.argwhere(defined):
            assert weights[q, index, a, axis] == pytest.approx(numeric[q, a], rel=1e-4, abs=1e-5), (JOINT_NAMES[q], a, axis)
