"""The detections of one person: at most one per camera, settled by fusing them and asking again."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array

from .candidates import Candidates, agreement, joint_points
from .settings import AssociateSettings

# a person needs this many keypoints in 3D: fewer do not identify the person
LEAST_POINTS = 3


def best_per_camera(candidates: Candidates, support: Array) -> Array:
    """Indices of the best supported detection of each camera; cameras without support have none."""
    order = np.argsort(-support, kind="stable")
    order = order[support[order] > 0]
    _, first = np.unique(candidates.camera[order], return_index=True)
    return np.sort(order[first])


def refined_members(candidates: Candidates, members: Array, free: Array, settings: AssociateSettings) -> Array:
    """Fuse the members and ask every free detection again; once more with the answer. A single member stays as it is."""
    for _ in range(2):
        if len(members) < 2:
            return members
        pose = joint_points(candidates, members, settings.tolerance_m)
        if np.isfinite(pose[:, 0]).sum() < LEAST_POINTS:
            return members[:0]
        support, share = agreement(candidates, pose[None], settings.tolerance_m)
        members = best_per_camera(candidates, np.where((share[0] >= settings.min_share) & free, support[0], 0.0))
    return members
