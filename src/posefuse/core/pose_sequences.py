"""Poses over time with a changing set of people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .errors import ShapeError
from .poses import Kind, Pose3D, PoseSequence


def sequence_of_all(poses: Sequence[Pose3D]) -> PoseSequence:
    """Poses of increasing times with all people of any of them; a person is missing (NaN) in poses without that person.

    Raises:
        ShapeError: no pose, another skeleton, or times that do not increase.
    """
    if not poses:
        raise ShapeError("PoseSequence: expected at least 1 pose, got 0")
    skeleton = poses[0].skeleton
    if any(pose.skeleton != skeleton for pose in poses):
        raise ShapeError("PoseSequence: expected the same skeleton in every pose")
    ids = np.unique(np.concatenate([pose.person_id for pose in poses]))
    shape = (len(poses), len(ids), len(skeleton))
    planes = {
        "xyz_world": np.full((*shape, 3), np.nan),
        "cov_world": np.full((*shape, 3, 3), np.nan),
        "reproj_px": np.full(shape, np.nan),
        "n_views": np.zeros(shape, np.uint8),
        "kind": np.full(shape, Kind.MISSING, np.uint8),
    }
    for i, pose in enumerate(poses):
        at = np.searchsorted(ids, pose.person_id)
        for name, plane in planes.items():
            plane[i, at] = getattr(pose, name)
    return PoseSequence(t_ns=np.array([pose.t_ns for pose in poses]), skeleton=skeleton, person_id=ids, **planes)
