"""One time step of the whole-body fit: scipy's least squares on the same cost, written out again, finds nothing better there."""

import numpy as np
import pytest
from built import poses
from scipy.optimize import least_squares

from posefuse.core.skeleton import COCO17
from posefuse.foundation.settings import settings_from_mapping
from posefuse.kinematics.body import BodyModel, BodySettings, bodies_from_poses, fit_kernels, tree_kernels
from posefuse.kinematics.body.filter import guessed_state
from posefuse.kinematics.body.model import Packed, packed_from_body
from posefuse.kinematics.joints import FrameBuffers
from posefuse.kinematics.settings import JointSettings
from posefuse_sim.exact import truth_of
from posefuse_sim.scene import Scene

DOF, SIGMA_PX, PRIOR_SD = 4.0, 2.0, 1.0
SCENE = {
    "duration_s": 0.5,
    "rate_hz": 20,
    "cameras": {"kind": "ring", "count": 2, "radius_m": 4.0, "image": {"size_px": [64, 48], "horizontal_fov_deg": 60}},
    "people": [{"motion": {"kind": "squat", "period_s": 1.0}}],
}


@pytest.fixture(scope="module")
def someone() -> tuple[BodyModel, Packed, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """A body, its arrays, keypoints (A, 3) of the last time step and the state guessed from them."""
    xyz = truth_of(settings_from_mapping(SCENE, Scene, where="squat")).xyz_world[:, :, : len(COCO17)]
    body = bodies_from_poses(poses(xyz, 1e-3, rate_hz=20.0))[0]
    packed = packed_from_body(body, BodySettings(joint_limits=False))
    points = xyz[-1, 0, body.keypoint]
    state = guessed_state(body, packed, FrameBuffers(COCO17, JointSettings()), points)
    assert state is not None
    return body, packed, points, state


def places(p: Packed, q: np.ndarray, rot: np.ndarray) -> np.ndarray:
    """(A, 3) keypoints of a state."""
    frame, origin = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
    tree_kernels.forward_kinematics(p.tree.parent, p.tree.kind, p.tree.axis, p.tree.offset, q, rot, frame, origin)
    return np.stack([origin[n] + frame[n] @ local for n, local in zip(p.tree.node, p.tree.local, strict=True)])


@pytest.mark.parametrize("outliers", [0, 4])
def test_the_same_rays_and_cost_give_the_same_body(someone, ring_rig, outliers: int) -> None:
    body, p, points, (q0, rot0) = someone
    rng, projections = np.random.default_rng(5), ring_rig(4).projections()
    homogeneous = np.einsum("cij,aj->aci", projections, np.c_[points, np.ones(len(points))])
    xy = homogeneous[..., :2] / homogeneous[..., 2:] + rng.normal(size=(len(points), 4, 2)) * SIGMA_PX
    xy.reshape(-1, 2)[rng.choice(xy[..., 0].size, outliers, replace=False)] += 40.0
    prior = np.eye(p.size) / PRIOR_SD**2

    def moved(step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        q, rot = q0.copy(), rot0.copy()
        tree_kernels.retract(p.tree.kind, p.tree.dof, step, q, rot)
        return q, rot

    def residuals(step: np.ndarray) -> np.ndarray:
        q, rot = moved(step)
        seen = np.einsum("cij,aj->aci", projections, np.c_[places(p, q, rot), np.ones(len(points))])
        square = ((seen[..., :2] / seen[..., 2:] - xy) ** 2).sum(axis=-1) / SIGMA_PX**2
        student = np.sqrt((DOF + 2) * np.log1p(square / DOF))
        return np.concatenate([student.ravel(), tree_kernels.difference(p.tree.kind, p.tree.dof, q, rot, q0, rot0) / PRIOR_SD])

    q, rot = q0.copy(), rot0.copy()
    nothing = np.zeros((len(points), 3, 3))
    rays = fit_kernels.SeenKeypoints(points, nothing, projections, xy, np.full(xy.shape[:2], SIGMA_PX**-2))
    free = np.full(len(body.nodes), np.inf)
    fit_kernels.gauss_newton(p.tree, (q0.copy(), rot0.copy()), prior, free, rays, DOF, 1.0, 60, q, rot)
    ours = tree_kernels.difference(p.tree.kind, p.tree.dof, q, rot, q0, rot0)
    theirs = least_squares(residuals, ours, max_nfev=20)
    assert np.linalg.norm(places(p, q, rot) - places(p, *moved(theirs.x)), axis=-1).max() < 0.002
    assert (residuals(ours) ** 2).sum() < 2 * theirs.cost + 1e-2
    assert np.linalg.norm(places(p, q, rot) - points, axis=-1).max() < 0.03
