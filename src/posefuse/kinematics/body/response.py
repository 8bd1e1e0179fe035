"""What an error of the segment lengths does to the keypoints, with the pose fitted again to the same rays."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array

from . import kernels
from .filter import Measurement
from .packed import Packed

# a degree of freedom without any ray keeps its value
_WEAK = 1.0


def length_response(p: Packed, seen: Measurement, robust: float, points: Array, by_state: Array, by_length: Array) -> Array:
    """(A, 3, S) metres that each keypoint moves per metre of each segment.

    Where several views see a joint it hardly moves; where one does, it moves along the ray; unseen, it moves with its segment.

    Args:
        seen: the rays. points, by_state, by_length: (A, 3), (A, 3, D), (A, 3, S) keypoints and their derivatives.
    """
    information = np.zeros((len(points), 3, 3))
    gradient = np.empty(3)
    for a, x in enumerate(points):
        kernels.ray_information(x, seen.projections, seen.xy[a], seen.inverse_var[a], robust, gradient, information[a])
    pulled = np.einsum("aid,aij->adj", by_state, information)
    slack = np.where(p.slack_var > 0, 1 / np.where(p.slack_var > 0, p.slack_var, 1.0), _WEAK)
    hessian = np.einsum("adj,aje->de", pulled, by_state) + np.diag(slack)
    follows = np.linalg.solve(hessian, np.einsum("adj,ajs->ds", pulled, by_length))
    return np.asarray(by_length - by_state @ follows)


def robust_variance_factor(seen: Measurement, robust: float, points: Array) -> Array:
    """(A,) by how much the rays are farther from the points (A, 3) of a fit than stated, as a factor of variance from 1 on.

    The Birge ratio, chi-squared by its degrees of freedom, with the Student-t weights of the fit: an outlier counts little. One
    ray agrees with any point.
    """
    xyz = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    projected = np.einsum("cij,aj->aci", seen.projections, xyz)
    square = ((projected[..., :2] / projected[..., 2:] - seen.xy) ** 2).sum(axis=-1) * seen.inverse_var
    counts = (seen.inverse_var > 0) & np.isfinite(square)
    weighted = np.where(counts, square * (robust + 2) / (robust + np.where(counts, square, 0)), 0)
    freedom = 2 * counts.sum(axis=1) - 3
    return np.maximum(np.where(freedom > 0, weighted.sum(axis=1) / np.maximum(freedom, 1), 1.0), 1.0)


def length_derivatives(p: Packed, slopes: Array, frame: Array) -> Array:
    """(A, 3, S) metres that each keypoint moves per metre of each segment, the pose held: turns (nodes, 3, 3) of the nodes."""
    above = np.where((p.tree.parent >= 0)[:, None, None], frame[p.tree.parent], np.eye(3))
    moved = np.einsum("nij,nsj->nis", above, slopes)
    for n, parent in enumerate(p.tree.parent):
        if parent >= 0:
            moved[n] += moved[parent]
    return np.ascontiguousarray(moved[p.tree.node])
