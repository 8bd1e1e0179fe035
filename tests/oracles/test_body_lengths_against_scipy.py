"""Segment lengths and poses of several time steps together: scipy's least squares on the same cost finds the same lengths."""

import numpy as np
from built import poses
from scipy.optimize import least_squares

from posefuse.core.skeleton import COCO17
from posefuse.foundation.settings import settings_from_mapping
from posefuse.kinematics.body import BodySettings, LengthPrior, bodies_from_poses, fit_kernels, tree_kernels, with_solved_lengths
from posefuse.kinematics.body.filter import Measurement, guessed_state
from posefuse.kinematics.body.model import packed_from_body
from posefuse.kinematics.body.shape import slopes_of
from posefuse.kinematics.joints import FrameBuffers
from posefuse.kinematics.settings import JointSettings
from posefuse_sim.exact import truth_of
from posefuse_sim.scene import Scene

DOF, SIGMA_PX = 4.0, 1.0
NAMES = ("upper_arm", "forearm", "thigh", "shank", "shoulders", "hips", "trunk")
MEAN_M = np.array([0.28, 0.25, 0.41, 0.42, 0.34, 0.19, 0.50])
PRIOR_SD_M = 0.02
SETTINGS = BodySettings(joint_limits=False, noise_memory_s=0.0, offset_sigma_m=0.0, hip_sigma_m=0.0, robust_dof=DOF)
SCENE = {
    "duration_s": 0.9,
    "rate_hz": 10,
    "cameras": {"kind": "ring", "count": 2, "radius_m": 4.0, "image": {"size_px": [64, 48], "horizontal_fov_deg": 60}},
    "people": [{"motion": {"kind": "squat", "period_s": 1.5}}],
}
STEPS = (3, 7)


def places(p, offset: np.ndarray, q: np.ndarray, rot: np.ndarray) -> np.ndarray:
    """(A, 3) keypoints of a state with these offsets of the nodes."""
    frame, origin = np.empty((len(q), 3, 3)), np.empty((len(q), 3))
    tree_kernels.forward_kinematics(p.tree.parent, p.tree.kind, p.tree.axis, offset, q, rot, frame, origin)
    return np.stack([origin[n] + frame[n] @ local for n, local in zip(p.tree.node, p.tree.local, strict=True)])


def solved_pose(p, state, one: Measurement) -> tuple[np.ndarray, np.ndarray]:
    """Where scipy begins: its own descent in poses needs thousands of steps."""
    (q, rot), slack = state, p.slack_var > 0
    weak = np.diag(np.where(slack, 1 / np.where(slack, p.slack_var, 1.0), 1e-9))
    rays = fit_kernels.SeenKeypoints(one.xyz, np.zeros((len(p.tree.node), 3, 3)), one.projections, one.xy, one.inverse_var)
    expected = np.where(np.diff(p.tree.dof) == 1, 0.0, q), rot.copy()
    fit_kernels.gauss_newton(p.tree, expected, weak, p.preferred_sd, rays, DOF, 1.0, 60, q, rot)
    return q, rot


def test_lengths_solved_with_poses_are_those_of_another_solver(ring_rig) -> None:
    xyz = truth_of(settings_from_mapping(SCENE, Scene, where="squat")).xyz_world[:, :, : len(COCO17)]
    start = bodies_from_poses(poses(xyz, 1e-3, rate_hz=10.0))[0]
    projections, rng = ring_rig(4).projections(), np.random.default_rng(3)
    seen = []
    for i in STEPS:
        points = xyz[i, 0, start.keypoint]
        homogeneous = np.einsum("cij,aj->aci", projections, np.c_[points, np.ones(len(points))])
        xy = homogeneous[..., :2] / homogeneous[..., 2:] + rng.normal(size=(len(points), 4, 2)) * SIGMA_PX
        seen.append(
            Measurement(
                t_ns=i * 100_000_000,
                xyz=points,
                cov=np.full((len(points), 3, 3), np.nan),
                projections=projections,
                xy=xy,
                inverse_var=np.full(xy.shape[:2], SIGMA_PX**-2),
            )
        )
    prior = LengthPrior(names=NAMES, mean_m=MEAN_M, cov_m2=np.eye(len(NAMES)) * PRIOR_SD_M**2)
    work = FrameBuffers(COCO17, JointSettings())
    body = with_solved_lengths(start, seen, prior, SETTINGS, work)
    p, slopes = packed_from_body(body, SETTINGS), slopes_of(start, NAMES)
    share = np.linalg.norm(slopes, axis=-1)
    keys = share.argmax(axis=0)
    solved = np.array([np.linalg.norm(body.offset[n]) / share[n, s] for s, n in enumerate(keys)])
    slack = p.slack_var > 0
    size = p.size
    states = [solved_pose(p, guessed_state(body, p, work, one.xyz), one) for one in seen]

    def residuals(x: np.ndarray) -> np.ndarray:
        longer = x[: len(NAMES)]
        offset = body.offset + np.einsum("nsi,s->ni", slopes, longer)
        out = [(solved + longer - MEAN_M) / PRIOR_SD_M]
        for i, (one, state) in enumerate(zip(seen, states, strict=True)):
            q, rot = state[0].copy(), state[1].copy()
            tree_kernels.retract(p.tree.kind, p.tree.dof, x[len(NAMES) + i * size : len(NAMES) + (i + 1) * size], q, rot)
            points = places(p, offset, q, rot)
            there = np.einsum("cij,aj->aci", projections, np.c_[points, np.ones(len(points))])
            square = ((there[..., :2] / there[..., 2:] - one.xy) ** 2).sum(axis=-1) / SIGMA_PX**2
            out.append(np.sqrt((DOF + 2) * np.log1p(square / DOF)).ravel())
            zero = tree_kernels.difference(p.tree.kind, p.tree.dof, q, rot, np.zeros_like(q), np.tile(np.eye(3), (len(q), 1, 1)))
            sd = np.repeat(p.preferred_sd, np.diff(p.tree.dof))
            out.append(zero / np.where(slack, np.sqrt(np.where(slack, p.slack_var, 1.0)), sd))
        return np.concatenate(out)

    theirs = least_squares(residuals, np.zeros(len(NAMES) + len(seen) * size), max_nfev=4)
    assert np.abs(theirs.x[: len(NAMES)]).max() < 0.002
    assert np.abs(solved - MEAN_M).max() > 0.01  # the rays do say something
