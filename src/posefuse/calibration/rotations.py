"""Stacks of rotation matrices and rigid motions, as the solvers use them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from posefuse.core import SE3, Camera
from posefuse.core.arrays import Array


@dataclass(frozen=True, eq=False)
class Poses:
    """Rigid transforms as matrices: R (..., 3, 3) and t (..., 3). Names of variables read a_from_b."""

    R: Array
    t: Array

    @staticmethod
    def identity(count: int) -> Poses:
        """`count` transforms that move nothing."""
        return Poses(np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))

    @staticmethod
    def from_se3(pose: SE3) -> Poses:
        """The same transform(s) as matrices."""
        return Poses(pose.matrix(), pose.xyz)

    def se3(self) -> SE3:
        """The same transform(s) as the shared value."""
        return SE3.from_matrix(self.R, self.t)

    def __matmul__(self, other: Poses) -> Poses:
        return Poses(self.R @ other.R, (self.R @ other.t[..., None])[..., 0] + self.t)

    def __getitem__(self, index: Any) -> Poses:
        return Poses(self.R[index], self.t[index])

    def __len__(self) -> int:
        return len(self.t)

    @property
    def listed(self) -> Poses:
        """All that are known, as one stack: those with a NaN are left out."""
        flat = Poses(self.R.reshape(-1, 3, 3), self.t.reshape(-1, 3))
        return flat[np.isfinite(flat.t).all(axis=1)]

    def inverse(self) -> Poses:
        """b_from_a of a_from_b."""
        back = np.swapaxes(self.R, -1, -2)
        return Poses(back, -(back @ self.t[..., None])[..., 0])

    def move(self, xyz: Array) -> Array:
        """Points (..., 3), one per transform (or broadcast)."""
        return np.asarray((self.R @ xyz[..., None])[..., 0] + self.t)

    def stepped(self, step: Array) -> Poses:
        """Turned by rotation vectors step[..., :3] from the left, origin shifted by step[..., 3:]."""
        turn = SE3.from_rotvec(step[..., :3], np.zeros_like(step[..., :3])).matrix()
        return Poses(turn @ self.R, self.t + step[..., 3:])


def stacked(poses: list[Poses]) -> Poses:
    """Single transforms as one stack."""
    return Poses(np.stack([p.R for p in poses]), np.stack([p.t for p in poses]))


def poses_of(cameras: Iterable[Camera]) -> Poses:
    """(C) cam_from_world of the cameras."""
    return stacked([Poses.from_se3(camera.cam_from_world) for camera in cameras])


def hat(v: Array) -> Array:
    """(..., 3, 3) matrices of the cross product with vectors (..., 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return np.asarray(out - np.swapaxes(out, -1, -2))


def angle_between(R_a: Array, R_b: Array) -> Array:
    """Angle (...) in rad of the rotation from one matrix to the other."""
    cosine = (np.einsum("...ij,...ij->...", R_a, R_b) - 1) / 2
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)))


def mean_rotation(R: Array, weights: Array) -> Array:
    """(3, 3) weighted chordal mean of rotations (N, 3, 3)."""
    return nearest_rotation(np.einsum("n,nij->ij", weights, R))


def nearest_rotation(matrix: Array) -> Array:
    """The rotations nearest to matrices (..., 3, 3), in the sum of squares of their elements."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., -1] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return np.asarray(u @ vt)


def centre_covariance_m2(cam_from_world: Poses, covariance: Array) -> Array:
    """(..., 3, 3) of the centres of cameras, from that (..., 6, 6) of turns from the left (rad) and shifts (m) of their poses."""
    R, t = cam_from_world.R, cam_from_world.t
    # centre = -R^T t; a left turn w moves R, not t: d centre = -R^T (dt + [t]x w)
    slope = -np.swapaxes(R, -1, -2) @ np.concatenate([hat(t), np.broadcast_to(np.eye(3), R.shape)], axis=-1)
    return np.asarray(slope @ covariance @ np.swapaxes(slope, -1, -2))
