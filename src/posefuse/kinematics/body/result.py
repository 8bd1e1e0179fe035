"""A fitted body's state to keypoints, segment frames and angles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array
from posefuse.kinematics.definitions import LIMBS
from posefuse.kinematics.joints import FrameBuffers
from posefuse.kinematics.kernels import PLANE_SIZE

from . import fit_kernels
from .filter import BodyFilter, Measurement, State
from .model import landmark_rows
from .tree_kernels import Tree, keypoints

# What an error of the segment lengths does to the keypoints, with the pose fitted again to the same rays.

# a degree of freedom without any ray keeps its value
_WEAK = 1.0


def length_response(tree: Tree, seen: Measurement, robust: float, points: Array, by_state: Array, by_length: Array) -> Array:
    """(A, 3, S) metres that each keypoint moves per metre of each segment.

    Where several views see a joint it hardly moves; where one does, it moves along the ray; unseen, it moves with its segment.

    Args:
        seen: the rays. points, by_state, by_length: (A, 3), (A, 3, D), (A, 3, S) keypoints and their derivatives.
    """
    information = np.zeros((len(points), 3, 3))
    gradient = np.empty(3)
    for a, x in enumerate(points):
        fit_kernels.ray_information(x, seen.projections, seen.xy[a], seen.inverse_var[a], robust, gradient, information[a])
    pulled = np.einsum("aid,aij->adj", by_state, information)
    hessian = np.einsum("adj,aje->de", pulled, by_state) + tree.held(_WEAK)
    follows = np.linalg.solve(hessian, np.einsum("adj,ajs->ds", pulled, by_length))
    return np.asarray(by_length - by_state @ follows)


def squared_misses(points: Array, projections: Array, xy: Array, inverse_var: Array) -> Array:
    """(A, C) squared distances of rays (A, C, 2) in cameras (C, 3, 4) from points (A, 3), by variance; NaN where unseen."""
    projected = np.einsum("cij,aj->aci", projections[..., :3], points) + projections[..., 3]
    square = ((projected[..., :2] / projected[..., 2:] - xy) ** 2).sum(axis=-1) * inverse_var
    return np.where(inverse_var > 0, square, np.nan)


def variance_factor(square: Array, robust: float) -> Array:
    """(A,) by how much rays are farther from points than stated (`squared_misses`), as a factor of variance from 1 on.

    The Birge ratio, chi-squared by its degrees of freedom, with the Student-t weights of the fit: an outlier counts little. One
    ray agrees with any point.
    """
    counts = np.isfinite(square)
    weighted = np.where(counts, square * (robust + 2) / (robust + np.where(counts, square, 0)), 0)
    freedom = 2 * counts.sum(axis=1) - 3
    return np.maximum(np.where(freedom > 0, weighted.sum(axis=1) / np.maximum(freedom, 1), 1.0), 1.0)


def length_derivatives(tree: Tree, slopes: Array, frame: Array) -> Array:
    """(A, 3, S) metres that each keypoint moves per metre of each segment, the pose held: turns (nodes, 3, 3) of the nodes."""
    above = np.where((tree.parent >= 0)[:, None, None], frame[tree.parent], np.eye(3))
    moved = np.einsum("nij,nsj->nis", above, slopes)
    for n, parent in enumerate(tree.parent):
        if parent >= 0:
            moved[n] += moved[parent]
    return np.ascontiguousarray(moved[tree.node])


_LIMB_NODE = {"left_arm": "left_shoulder", "right_arm": "right_shoulder", "left_leg": "left_hip", "right_leg": "right_hip"}


@dataclass(frozen=True, eq=False, kw_only=True)
class Fitted:
    """One person at one time step: keypoints of the tree (A, ...), frames (S, ...) and angles (J, 3)."""

    xyz: Array
    cov: Array
    rotation: Array
    origin: Array
    angles: Array
    sigmas: Array


class StateReader:
    """Reads states of one body. Remembers only which turn each angle is on."""

    def __init__(self, filter_: BodyFilter, workspace: FrameBuffers) -> None:
        self._tree, self._body, self._work = filter_.tree, filter_.body, workspace
        self._rows = landmark_rows(filter_.body)
        self._offset_var, self._robust = filter_.settings.offset_sigma_m**2, filter_.settings.robust_dof
        hips = [self._body.skeleton.keypoints[k].endswith("_hip") for k in self._body.keypoint]
        self._own_var = np.where(hips, filter_.settings.hip_sigma_m**2, self._offset_var)
        nodes, points = len(self._body.nodes), len(self._body.keypoint)
        self._frame, self._origin = np.empty((nodes, 3, 3)), np.empty((nodes, 3))
        self._points, self._jacobians = np.empty((points, 3)), np.empty((points, 3, self._tree.size))
        names = [node.name for node in self._body.nodes]
        self._limb_nodes = [names.index(node) if (node := _LIMB_NODE[limb.name]) in names else -1 for limb in LIMBS]
        self._last = np.full((len(workspace.angles), 3), np.nan)

    def read(self, state: State, seen: Measurement | None = None) -> Fitted:
        """All results of the state, with their uncertainty; with that of segment lengths where the rays are given.

        Where these disagree more than they state, the covariance grows with it.
        """
        work, size = self._work, self._tree.size
        self._place(state)
        cov_state = np.ascontiguousarray(state.cov[:size, :size])
        own = self._offset_var * np.eye(3)
        cov = self._cov(state) + self._own_var[:, None, None] * np.eye(3)
        if seen is not None and self._body.length_cov.size:
            by_length = length_derivatives(self._tree, self._body.length_slopes, self._frame)
            moves = length_response(self._tree, seen, self._robust, self._points, self._jacobians, by_length)
            cov = cov + moves @ self._body.length_cov @ np.swapaxes(moves, -1, -2)
        if seen is not None and seen.standing_cov is not None:
            cov = cov + seen.standing_cov
        if seen is not None and len(seen.projections):
            square = squared_misses(self._points, seen.projections, seen.xy, seen.inverse_var)
            cov = cov * variance_factor(square, self._robust)[:, None, None]
        xyz = np.full((len(self._body.skeleton), 3), np.nan)
        xyz[self._body.keypoint] = self._points
        work.read(xyz, np.broadcast_to(own, (len(xyz), 3, 3)))
        # the tree has a turn of every limb; angles have its uncertainty, and are missing where it is unknown
        work.solve(self._planes(np.zeros_like(cov_state)))
        rotation = work.rotation.copy()
        work.solve(self._planes(cov_state))
        by_state = np.tensordot(work.weights, self._of_landmarks(), axes=([1, 3], [0, 1]))
        work.sigmas[:] = np.sqrt(work.sigmas**2 + (by_state @ cov_state * by_state).sum(axis=-1))
        work.drop_uncertain()
        work.unwrap(self._last)
        return Fitted(
            xyz=self._points.copy(),
            cov=cov,
            rotation=rotation,
            origin=work.origins(),
            angles=work.angles.copy(),
            sigmas=work.sigmas.copy(),
        )

    def _of_landmarks(self) -> Array:
        """(P, 3, D) derivatives of landmarks by the state; 0 where the tree does not carry one."""
        carried = self._rows[:, :1, None] >= 0
        return np.where(carried, self._jacobians[self._rows].mean(axis=1), 0.0)

    def points(self, state: State) -> tuple[Array, Array]:
        """(A, 3), (A, 3, 3) keypoints of the tree alone, with the covariance that the state gives them."""
        self._place(state)
        return self._points.copy(), self._cov(state)

    def _cov(self, state: State) -> Array:
        size = self._tree.size
        return np.asarray(self._jacobians @ state.cov[:size, :size] @ np.swapaxes(self._jacobians, -1, -2))

    def _place(self, state: State) -> None:
        keypoints(self._tree, state.q, state.rot, self._frame, self._origin, self._points, self._jacobians)

    def _planes(self, cov: Array) -> Array:
        """The limb planes as the tree itself holds them, straight or not."""
        planes = np.full((len(LIMBS), PLANE_SIZE), np.nan)
        for i, node in enumerate(self._limb_nodes):
            if node >= 0:
                turn = self._tree.dof[node] + 1
                planes[i] = [*self._frame[node][:, 2], cov[turn, turn], np.inf, 0.0]
        return planes
