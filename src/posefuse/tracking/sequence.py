"""Time steps in a row to one sequence of the same people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posefuse.core import Pose3D, PoseSequence, ShapeError


def sequence_from_poses(poses: Sequence[Pose3D]) -> PoseSequence:
    """Stack time steps with changing people: every person has a row throughout, NaN where absent.

    Raises:
        ShapeError: no pose at all, different skeletons, or times that do not increase.
    """
    if not poses:
        raise ShapeError("sequence_from_poses: expected at least 1 pose, got 0")
    skeleton = poses[0].skeleton
    if any(pose.skeleton != skeleton for pose in poses):
        raise ShapeError("sequence_from_poses: expected the same skeleton in every pose")
    people = np.unique(np.concatenate([pose.person_id for pose in poses])).astype(np.int64)
    shape = (len(poses), len(people), len(skeleton))
    xyz, cov, reproj = np.full((*shape, 3), np.nan), np.full((*shape, 3, 3), np.nan), np.full(shape, np.nan)
    n_views, kind = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    for i, pose in enumerate(poses):
        rows = np.searchsorted(people, pose.person_id)
        xyz[i, rows], cov[i, rows], reproj[i, rows] = pose.xyz_world, pose.cov_world, pose.reproj_px
        n_views[i, rows], kind[i, rows] = pose.n_views, pose.kind
    return PoseSequence(
        t_ns=np.array([pose.t_ns for pose in poses]),
        skeleton=skeleton,
        person_id=people,
        xyz_world=xyz,
        cov_world=cov,
        reproj_px=reproj,
        n_views=n_views,
        kind=kind,
    )
