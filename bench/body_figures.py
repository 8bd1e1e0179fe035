"""What `bench/body_held_out.py` measures of one person's recording against the truth."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from harness import JOINTS, exact_poses

from posefuse.core import PoseSequence, Truth
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import SIDES, pick_keypoints
from posefuse.evaluation.metrics import joint_errors, true_xyz_at, typical_nees
from posefuse.kinematics import JOINT_NAMES, joints_from_poses
from posefuse.tracking.body_directions import segment_lengths

ENDS = tuple(joint.removeprefix("left_") for joint in JOINTS if joint.startswith("left_"))
FLEXIONS = ("hip", "knee", "elbow")
SIGMAS_90 = 1.645
_SOLE = ("heel", "big_toe")
# a point of a foot that moves slower than this, for so long at least, stands
_STANDS_M_S, _STANCE_S = 0.1, 0.25


def figures(poses: PoseSequence, truth: Truth) -> dict[str, float]:
    """Of the one person of a recording."""
    errors = joint_errors(poses, truth)
    inside = np.flatnonzero((poses.t_ns >= truth.t_ns[0]) & (poses.t_ns <= truth.t_ns[-1]))
    true_xyz = true_xyz_at(truth, poses.t_ns[inside])[:, 0]
    away = poses.xyz_world[inside, 0][:, poses.skeleton.indices(JOINTS)] - pick_keypoints(true_xyz, truth.skeleton, JOINTS)
    sigma = np.sqrt(np.diagonal(poses.cov_world[inside, 0][:, poses.skeleton.indices(JOINTS)], axis1=-2, axis2=-1))
    lengths, true_lengths = (segment_lengths(one.xyz_world, one.skeleton)[0] for one in (poses, truth))
    return {
        **{f"{joint} mm": float(mm) for joint, mm in zip(errors.joints, errors.mean_mm, strict=True)},
        "nees": typical_nees(poses, truth, JOINTS),
        "skate_mm": skate_mm(poses, truth),
        **{f"{end} held": _held(*(one[:, [JOINTS.index(f"{s}_{end}") for s in SIDES]] for one in (away, sigma))) for end in ENDS},
        **{f"{name} off": float(abs(a - b) / b) for name, a, b in zip(SEGMENT_ENDS, lengths, true_lengths, strict=True)},
        **_flexions(poses, truth, inside),
    }


def _held(away: np.ndarray, sigma: np.ndarray) -> float:
    """Share of known values that lie within the 90 % interval."""
    known = np.isfinite(away) & np.isfinite(sigma)
    return float((np.abs(away[known]) < SIGMAS_90 * sigma[known]).sum() / max(known.sum(), 1))


def skate_mm(poses: PoseSequence, truth: Truth, after_s: float = 0.0) -> float:
    """Mean over stances of the largest horizontal distance between two places of a point of the foot that in truth stands.

    The first `after_s` of each stance are left out.
    """
    found = []
    for name in (f"{side}_{part}" for side in SIDES for part in _SOLE):
        true = pick_keypoints(truth.xyz_world[:, 0], truth.skeleton, (name,))[:, 0]
        got = pick_keypoints(poses.xyz_world[:, 0], poses.skeleton, (name,))[:, 0, :2]
        for begin_ns, end_ns in _stances(truth.t_ns, true):
            during = got[(poses.t_ns >= begin_ns + after_s * 1e9) & (poses.t_ns <= end_ns)]
            during = during[np.isfinite(during).all(axis=-1)]
            if len(during) > 1:
                found.append(float(np.linalg.norm(during[:, None] - during[None], axis=-1).max()))
    return 1000 * float(np.mean(found)) if found else float("nan")


def _stances(t_ns: np.ndarray, xyz: np.ndarray) -> Iterator[tuple[int, int]]:
    slow = np.linalg.norm(np.gradient(xyz, t_ns * 1e-9, axis=0), axis=-1) < _STANDS_M_S
    edges = np.flatnonzero(np.diff(np.concatenate([[0], slow.astype(int), [0]])))
    for begin, end in edges.reshape(-1, 2):
        if (t_ns[end - 1] - t_ns[begin]) * 1e-9 >= _STANCE_S:
            yield int(t_ns[begin]), int(t_ns[end - 1])


def _flexions(poses: PoseSequence, truth: Truth, inside: np.ndarray) -> dict[str, float]:
    """RMSE of flexion angles in degrees, both sides together, and the share of 90 % intervals that hold."""
    joints, found = joints_from_poses(poses), dict[str, float]()
    wanted = joints_from_poses(exact_poses(truth, poses.t_ns[inside])).angle_rad[:, 0]
    for joint in FLEXIONS:
        at = [JOINT_NAMES.index(f"{side}_{joint}") for side in SIDES]
        away = joints.angle_rad[inside, 0][:, at, 0] - wanted[:, at, 0]
        found[f"{joint} deg"] = float(np.degrees(np.sqrt(np.nanmean(away**2))))
        found[f"{joint} angle held"] = _held(away, joints.sigma_rad[inside, 0][:, at, 0])
    return found
