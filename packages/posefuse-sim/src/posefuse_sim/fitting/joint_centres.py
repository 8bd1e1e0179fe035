"""Offsets from the keypoints of a detector to joint centres, from people whose joint centres are known exactly.

Judged by bodies left out: constants along directions of the body itself, and slopes on the segment lengths of the person.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posefuse.core import JointCentres, PoseSequence, Skeleton, Truth
from posefuse.core.arrays import Array
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import SIDES, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.tracking import to_joint_centres
from posefuse.tracking.body_directions import keypoint_of, segment_lengths
from posefuse.tracking.joint_centres import MOST_LONGER_M, joint_directions

# Directions each joint may be moved along, as found to pay by bodies left out. The hip is not moved along the spine as a whole:
# the mesh gives 12 mm down, real footage (bench/real_footage.py) gives up; "sinking" is nothing when standing, and grows as the
# thigh is lifted.
WANTED = {
    "shoulder": ("forward", "up", "outward", "arm", "raising"),
    "elbow": ("upper_arm", "bend", "lowering"),
    "wrist": ("forearm", "hand", "palm"),
    "hip": ("forward", "outward", "sinking"),
    "knee": ("thigh", "bend", "outward", "forward"),
    "ankle": ("shank", "foot", "outward"),
    "ear": ("face", "crown", "outward"),
    "nose": ("face", "crown"),
}
ARM = ("shoulder", "elbow", "wrist")
# Joints whose offsets also depend on the segment lengths of the person, where cross-validation over bodies shows a gain.
BY_LENGTH = ("shoulder", "hip", "knee", "ankle")
# what a slope of 1 costs, in time steps whose lengths are a metre off: keeps slopes small that the bodies do not determine
RIDGE = 0.3
# an error larger than this is a confusion, not an offset
MOST_M = 0.15
# errors beyond this pull with constant force
HUBER_M = 0.015
Run = tuple[PoseSequence, Truth]


def directions_of(skeleton: Skeleton) -> dict[str, tuple[str, ...]]:
    """Those of `WANTED` that a keypoint set determines: without fingers there is no palm."""
    xyz = np.random.default_rng(0).normal(size=(len(skeleton), 3))
    known = joint_directions(xyz, skeleton, "left")
    return {joint: tuple(name for name in names if np.isfinite(known[joint][name]).all()) for joint, names in WANTED.items()}


def samples(poses: PoseSequence, truth: Truth, joint: str, wanted: Sequence[str]) -> tuple[Array, Array]:
    """Directions (M, D, 3) and what is missing to the joint centre (M, 3) of both sides over time, confusions left out."""
    inside = (poses.t_ns >= truth.t_ns[0]) & (poses.t_ns <= truth.t_ns[-1])
    xyz, true_xyz = poses.xyz_world[inside, 0], true_xyz_at(truth, poses.t_ns[inside])[:, 0]
    along, missing = [], []
    for side in SIDES:
        known = joint_directions(xyz, poses.skeleton, side)[joint]
        rows = np.stack([known[name] for name in wanted], axis=-2)
        name = [keypoint_of(side, joint)]
        away = (pick_keypoints(true_xyz, truth.skeleton, name) - pick_keypoints(xyz, poses.skeleton, name))[:, 0]
        good = np.isfinite(rows).all(axis=(-1, -2)) & (np.linalg.norm(away, axis=-1) < MOST_M)
        along.append(rows[good])
        missing.append(away[good])
    return np.concatenate(along), np.concatenate(missing)


def huber_fit(along: Array, missing: Array, ridge: float = 0.0) -> Array:
    """(D,) metres along each direction (M, D, 3) of least Huber-like loss; `ridge` pulls them to zero."""
    design = along.swapaxes(-1, -2).reshape(-1, along.shape[1])
    weight = np.ones(len(missing))
    metres: Array = np.zeros(along.shape[1])
    for _ in range(20):
        w = np.repeat(weight, 3)[:, None]
        normal = (design * w).T @ design + ridge * np.eye(along.shape[1])
        metres = np.linalg.solve(normal, (design * w).T @ missing.reshape(-1))
        weight = HUBER_M / np.maximum(np.linalg.norm(missing - moved_by(along, metres), axis=-1), HUBER_M)
    return np.asarray(metres)


def moved_by(along: Array, metres: Array) -> Array:
    """(M, 3) of directions (M, D, 3) and metres (D,)."""
    return np.asarray(np.einsum("mdx,d->mx", along, metres))


def fit_joint_centres(runs: Sequence[Run], made_by: str = "") -> JointCentres:
    """Constants first; then, of what they leave, slopes on how much longer than usual each body is by those constants.

    Args:
        runs: poses as the detector marks them, time step by time step, and the truth; one keypoint set.
        made_by: for people.
    """
    wanted = directions_of(runs[0][0].skeleton)
    each = {joint: [samples(*run, joint, names) for run in runs] for joint, names in wanted.items()}
    offsets = {}
    for joint, parts in each.items():
        along, missing = (np.concatenate(rows) for rows in zip(*parts, strict=True))
        offsets[joint] = dict(zip(wanted[joint], huber_fit(along, missing).tolist(), strict=True))
    plain = JointCentres(made_by=made_by, offsets=offsets)
    lengths = np.concatenate([segment_lengths(to_joint_centres(p, plain).xyz_world, p.skeleton) for p, _ in runs])
    if not np.isfinite(lengths).any(axis=0).all():
        return plain
    usual = np.nanmean(lengths, axis=0)
    longer = np.clip(np.nan_to_num(lengths - usual), -MOST_LONGER_M, MOST_LONGER_M)
    by_length = {joint: _slopes(each[joint], wanted[joint], offsets[joint], longer) for joint in BY_LENGTH}
    return JointCentres(
        made_by=made_by, offsets=offsets, lengths=dict(zip(SEGMENT_ENDS, usual.tolist(), strict=True)), by_length=by_length
    )


def _slopes(
    parts: Sequence[tuple[Array, Array]], names: Sequence[str], offsets: dict[str, float], longer: Array
) -> dict[str, dict[str, float]]:
    """Direction -> segment -> metres per metre that a body's segment is longer (bodies, S)."""
    metres = np.array([offsets[name] for name in names])
    along = [(a[:, :, None] * own[:, None]).reshape(len(a), -1, 3) for (a, _), own in zip(parts, longer, strict=True)]
    left = np.concatenate([missing - moved_by(a, metres) for a, missing in parts])
    slopes = huber_fit(np.concatenate(along), left, RIDGE).reshape(-1, len(SEGMENT_ENDS))
    return {name: dict(zip(SEGMENT_ENDS, row, strict=True)) for name, row in zip(names, slopes.tolist(), strict=True)}
