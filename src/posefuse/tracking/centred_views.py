"""What the views of a finished recording saw, brought to the joint centres its 3D lies at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.core import JointCentres, PoseSequence, Rig, ViewSequence
from posefuse.core.arrays import Array

from .joint_centres import from_joint_centres
from .sides import sides_like


def views_at_joint_centres(poses: PoseSequence, rig: Rig, views: ViewSequence, table: JointCentres | None) -> ViewSequence:
    """A recording's views as if its detector marked joint centres, which is where its 3D is: rays then lead there.

    Each view's keypoints move by what lies between landmark and joint centre in that image, at every time step by the
    offsets in the body's own directions; where the 3D is missing, by as much as before and after. Left and right are named
    as in 3D. Without a table keypoints stay where they are.

    Args:
        poses: the 3D, at joint centres. rig, views: of the same people, cameras and time steps. table: of their offsets.
    """
    landmarks = from_joint_centres(poses, table) if table else poses
    named = sides_like(landmarks, rig, views)
    moves = np.stack([c.project(poses.xyz_world) - c.project(landmarks.xyz_world) for c in rig], axis=2)
    return replace(named, xy_img=named.xy_img + _bridged(moves))


def _bridged(moves: Array) -> Array:
    """(T, ...) with what is missing interpolated over time, 0 where nothing is known."""
    columns = moves.reshape(len(moves), -1).T.copy()
    for column in columns:
        known = np.isfinite(column)
        column[~known] = np.interp(np.flatnonzero(~known), np.flatnonzero(known), column[known]) if known.any() else 0.0
    return columns.T.reshape(moves.shape)
