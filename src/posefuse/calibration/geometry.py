"""What the solvers share: stacks of rigid motions, and pixels of points in camera axes, for all rows of a solve at once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from posefuse.core import SE3, Camera, lens
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


def nearest_rotation(matrix: Array) -> Array:
    """The rotations nearest to matrices (..., 3, 3), by the squares of their elements; of a sum of rotations: their mean."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., -1] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return np.asarray(u @ vt)


def centre_covariance_m2(cam_from_world: Poses, covariance: Array) -> Array:
    """(..., 3, 3) of the centres of cameras, from that (..., 6, 6) of turns from the left (rad) and shifts (m) of their poses."""
    R, t = cam_from_world.R, cam_from_world.t
    # centre = -R^T t; a left turn w moves R, not t: d centre = -R^T (dt + [t]x w)
    slope = -np.swapaxes(R, -1, -2) @ np.concatenate([hat(t), np.broadcast_to(np.eye(3), R.shape)], axis=-1)
    return np.asarray(slope @ covariance @ np.swapaxes(slope, -1, -2))


LENS_PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2")

_STEP_K = 1e-6


class Lenses:
    """The lenses of several cameras, without their poses; `delta` (C, 6) is added to `LENS_PARAMETERS`."""

    def __init__(self, cameras: Sequence[Camera], delta: Array | None = None) -> None:
        self._cameras = tuple(cameras)
        self.delta = np.zeros((len(cameras), len(LENS_PARAMETERS))) if delta is None else delta

    def camera_matrix(self, i: int) -> Array:
        """(3, 3) intrinsic matrix with its delta."""
        changed = self._cameras[i].K.copy()
        changed[[0, 1, 0, 1], [0, 1, 2, 2]] += self.delta[i, :4]
        return changed

    def distortion(self, i: int) -> Array:
        """Coefficients with their delta."""
        coefficients = self._cameras[i].distortion
        if not self.delta[i, 4:].any():
            return coefficients
        changed = np.concatenate([coefficients, np.zeros(max(0, 4 - len(coefficients)))])
        changed[:2] += self.delta[i, 4:]
        return changed

    def norm_from_px(self, camera: Array, xy_img: Array) -> Array:
        """Ideal image-plane points (N, 2) of raw px (N, 2) seen by cameras (N,)."""
        out = np.full((len(camera), 2), np.nan)
        for i in np.unique(camera):
            mine = camera == i
            bent = (xy_img[mine] - self.camera_matrix(i)[:2, 2]) @ np.linalg.inv(self.camera_matrix(i)[:2, :2]).T
            out[mine] = lens.undistort(bent, self.distortion(i), self._cameras[i].model)
        return out

    def px(self, camera: Array, xyz_cam: Array) -> Array:
        """Raw px (N, 2); NaN behind the camera."""
        xy = xyz_cam[:, :2] / _ahead(xyz_cam)[:, None]
        out = np.empty_like(xy)
        for i in np.unique(camera):
            mine = camera == i
            bent = lens.distort(xy[mine], self.distortion(i), self._cameras[i].model)
            out[mine] = bent @ self.camera_matrix(i)[:2, :2].T + self.camera_matrix(i)[:2, 2]
        return out

    def px_jacobian(self, camera: Array, xyz_cam: Array) -> Array:
        """(N, 2, 3) change of the px with the point; NaN behind the camera."""
        depth = _ahead(xyz_cam)
        xy = xyz_cam[:, :2] / depth[:, None]
        slope = np.empty((len(xy), 2, 2))
        for i in np.unique(camera):
            mine = camera == i
            slope[mine] = self.camera_matrix(i)[:2, :2] @ lens.slopes(xy[mine], self.distortion(i), self._cameras[i].model)
        d_norm = np.zeros((len(xy), 2, 3))
        d_norm[:, 0, 0] = d_norm[:, 1, 1] = 1 / depth
        d_norm[:, :, 2] = -xy / depth[:, None]
        return np.asarray(slope @ d_norm)

    def lens_jacobian(self, camera: Array, xyz_cam: Array) -> Array:
        """(N, 2, 6) change of the px with `LENS_PARAMETERS`, distortion by central differences: right for every lens model."""
        xy = xyz_cam[:, :2] / xyz_cam[:, 2:]
        out = np.zeros((len(xy), 2, len(LENS_PARAMETERS)))
        for i in np.unique(camera):
            mine = camera == i
            k, model, scale = self.distortion(i), self._cameras[i].model, self.camera_matrix(i)[:2, :2]
            bent = lens.distort(xy[mine], k, model)
            out[mine, 0, 0], out[mine, 1, 1] = bent[:, 0], bent[:, 1]
            out[mine, 0, 2] = out[mine, 1, 3] = 1.0
            k = np.concatenate([k, np.zeros(max(0, 4 - len(k)))])
            for column, step in enumerate(_STEP_K * np.eye(len(k))[:2], start=4):
                change = lens.distort(xy[mine], k + step, model) - lens.distort(xy[mine], k - step, model)
                out[mine, :, column] = change @ scale.T / (2 * _STEP_K)
        return out


def _ahead(xyz_cam: Array) -> Array:
    """(N,) depths; NaN behind the camera."""
    return np.where(xyz_cam[:, 2] > 0, xyz_cam[:, 2], np.nan)


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """For OpenCV's calibration: several threads sum its views in the order in which they are done, which differs in each run."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
