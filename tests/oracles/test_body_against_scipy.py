"""The whole-body fit: scipy's least squares on the same cost, written out again, finds nothing better."""

import numpy as np
import pytest
from built import poses, simulated
from scipy.optimize import least_squares

from posefuse.core import Rig
from posefuse.core.skeleton import COCO17
from posefuse.kinematics.body import BodySettings, LengthPrior, bodies_from_poses, fit_kernels, tree_kernels, with_solved_lengths
from posefuse.kinematics.body.filter import Measurement, guessed_state
from posefuse.kinematics.body.model import BodyModel, tree_from_body
from posefuse.kinematics.body.shape import slopes_of
from posefuse.kinematics.body.tree_kernels import Tree
from posefuse.kinematics.joints import FrameBuffers
from posefuse.kinematics.settings import JointSettings

DOF, PRIOR_SD = 4.0, 1.0
NAMES = ("upper_arm", "forearm", "thigh", "shank", "shoulders", "hips", "trunk")
MEAN_M = np.array([0.28, 0.25, 0.41, 0.42, 0.34, 0.19, 0.50])
PRIOR_SD_M = 0.02
SETTINGS = BodySettings(joint_limits=False, noise_memory_s=0.0, offset_sigma_m=0.0, hip_sigma_m=0.0, robust_dof=DOF)
STEPS = (3, 7)


def squatting(period_s: float, seconds: float, rate_hz: float) -> tuple[BodyModel, np.ndarray]:
    """A body, and its keypoints (T, A, 3)."""
    xyz = simulated({"kind": "squat", "period_s": period_s}, seconds, rate_hz)[:, :, : len(COCO17)]
    body = bodies_from_poses(poses(xyz, 1e-3, rate_hz=rate_hz))[0]
    return body, xyz[:, 0, body.keypoint]


def seen(projections: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(A, C, 2) px of points (A, 3)."""
    homogeneous = np.einsum("cij,aj->aci", projections, np.c_[points, np.ones(len(points))])
    return homogeneous[..., :2] / homogeneous[..., 2:]


def student(off_px: np.ndarray, sigma_px: float) -> np.ndarray:
    """What scipy squares and adds up of how far (A, C, 2) keypoints are from their rays."""
    return np.sqrt((DOF + 2) * np.log1p((off_px**2).sum(axis=-1) / sigma_px**2 / DOF)).ravel()


def places(tree: Tree, q: np.ndarray, rot: np.ndarray, offset: np.ndarray | None = None) -> np.ndarray:
    """(A, 3) keypoints of a state, with these offsets of the nodes."""
    frame, origin = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
    tree_kernels.forward_kinematics(tree if offset is None else tree._replace(offset=offset), q, rot, frame, origin)
    return np.stack([origin[n] + frame[n] @ local for n, local in zip(tree.node, tree.local, strict=True)])


def moved(tree: Tree, step: np.ndarray, state: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    q, rot = state[0].copy(), state[1].copy()
    tree_kernels.retract(tree, step, q, rot)
    return q, rot


@pytest.mark.parametrize("outliers", [0, 4])
def test_the_same_rays_and_cost_give_the_same_pose(ring_rig, outliers: int) -> None:
    sigma_px, (body, points) = 2.0, squatting(1.0, 0.5, 20.0)
    tree, points = tree_from_body(body, BodySettings(joint_limits=False)), points[-1]
    q0, rot0 = guessed_state(body, tree, FrameBuffers(COCO17, JointSettings()), points)
    rng, projections = np.random.default_rng(5), ring_rig(4).projections()
    xy = seen(projections, points)
    xy = xy + rng.normal(size=xy.shape) * sigma_px
    xy.reshape(-1, 2)[rng.choice(xy[..., 0].size, outliers, replace=False)] += 40.0
    prior = np.eye(tree.size) / PRIOR_SD**2

    def residuals(step: np.ndarray) -> np.ndarray:
        q, rot = moved(tree, step, (q0, rot0))
        off = tree_kernels.difference(tree, q, rot, q0, rot0) / PRIOR_SD
        return np.concatenate([student(seen(projections, places(tree, q, rot)) - xy, sigma_px), off])

    q, rot = q0.copy(), rot0.copy()
    nothing = np.zeros((len(points), 3, 3))
    rays = fit_kernels.SeenKeypoints(points, nothing, projections, xy, np.full(xy.shape[:2], sigma_px**-2))
    free = tree._replace(preferred_sd=np.full(len(body.nodes), np.inf))
    fit_kernels.gauss_newton(free, (q0.copy(), rot0.copy()), prior, 1.0, rays, DOF, 1.0, 60, q, rot)
    ours = tree_kernels.difference(tree, q, rot, q0, rot0)
    theirs = least_squares(residuals, ours, max_nfev=20)
    assert np.linalg.norm(places(tree, q, rot) - places(tree, *moved(tree, theirs.x, (q0, rot0))), axis=-1).max() < 0.002
    assert (residuals(ours) ** 2).sum() < 2 * theirs.cost + 1e-2
    assert np.linalg.norm(places(tree, q, rot) - points, axis=-1).max() < 0.03


def solved_pose(tree: Tree, state: tuple[np.ndarray, np.ndarray], one: Measurement) -> tuple[np.ndarray, np.ndarray]:
    """Where scipy begins: its own descent in poses needs thousands of steps."""
    (q, rot), slack = state, tree.slack_var > 0
    weak = np.diag(np.where(slack, 1 / np.where(slack, tree.slack_var, 1.0), 1e-9))
    rays = fit_kernels.SeenKeypoints(one.xyz, np.zeros((len(tree.node), 3, 3)), one.projections, one.xy, one.inverse_var)
    expected = np.where(np.diff(tree.dof) == 1, 0.0, q), rot.copy()
    fit_kernels.gauss_newton(tree, expected, weak, 1.0, rays, DOF, 1.0, 60, q, rot)
    return q, rot


def measured(rig: Rig, points: np.ndarray, t_ns: int, rng: np.random.Generator) -> Measurement:
    """Rays to points (A, 3), off by 1 px."""
    projections, unknown = rig.projections(), np.full((len(points), 3, 3), np.nan)
    xy = seen(projections, points)
    xy = xy + rng.normal(size=xy.shape)
    return Measurement(t_ns=t_ns, xyz=points, cov=unknown, projections=projections, xy=xy, inverse_var=np.ones(xy.shape[:2]))


def test_lengths_solved_with_poses_are_those_of_another_solver(ring_rig) -> None:
    """Segment lengths and the poses of several time steps together."""
    start, points = squatting(1.5, 0.9, 10.0)
    rng = np.random.default_rng(3)
    measurements = [measured(ring_rig(4), points[i], i * 100_000_000, rng) for i in STEPS]
    prior = LengthPrior(names=NAMES, mean_m=MEAN_M, cov_m2=np.eye(len(NAMES)) * PRIOR_SD_M**2)
    work = FrameBuffers(COCO17, JointSettings())
    body = with_solved_lengths(start, measurements, prior, SETTINGS, work)
    tree, slopes = tree_from_body(body, SETTINGS), slopes_of(start, NAMES)
    share = np.linalg.norm(slopes, axis=-1)
    solved = np.array([np.linalg.norm(body.offset[n]) / share[n, s] for s, n in enumerate(share.argmax(axis=0))])
    slack, size = tree.slack_var > 0, tree.size
    states = [solved_pose(tree, guessed_state(body, tree, work, one.xyz), one) for one in measurements]

    def residuals(x: np.ndarray) -> np.ndarray:
        longer = x[: len(NAMES)]
        offset = body.offset + np.einsum("nsi,s->ni", slopes, longer)
        out = [(solved + longer - MEAN_M) / PRIOR_SD_M]
        for i, (one, state) in enumerate(zip(measurements, states, strict=True)):
            q, rot = moved(tree, x[len(NAMES) + i * size : len(NAMES) + (i + 1) * size], state)
            out.append(student(seen(one.projections, places(tree, q, rot, offset)) - one.xy, 1.0))
            zero = tree_kernels.difference(tree, q, rot, np.zeros_like(q), np.tile(np.eye(3), (len(q), 1, 1)))
            sd = np.repeat(tree.preferred_sd, np.diff(tree.dof))
            out.append(zero / np.where(slack, np.sqrt(np.where(slack, tree.slack_var, 1.0)), sd))
        return np.concatenate(out)

    theirs = least_squares(residuals, np.zeros(len(NAMES) + len(measurements) * size), max_nfev=4)
    assert np.abs(theirs.x[: len(NAMES)]).max() < 0.002
    assert np.abs(solved - MEAN_M).max() > 0.01  # the rays do say something
