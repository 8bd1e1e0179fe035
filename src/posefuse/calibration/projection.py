"""Pixels of points in camera axes, and how they change: for all rows of a solve at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posefuse.core import Camera, lens
from posefuse.core.arrays import Array

LENS_PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2")

_STEP_NORM = _STEP_K = 1e-6


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
            slope[mine] = self._slope(i, xy[mine])
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

    def _slope(self, i: int, xy: Array) -> Array:
        """(n, 2, 2) d px / d norm, the lens by central differences (exact to 1e-9 for every lens model)."""
        scale, coefficients, model = self.camera_matrix(i)[:2, :2], self.distortion(i), self._cameras[i].model
        if len(coefficients) == 0:
            return np.broadcast_to(scale, (len(xy), 2, 2))
        columns = [
            (lens.distort(xy + step, coefficients, model) - lens.distort(xy - step, coefficients, model)) / (2 * _STEP_NORM)
            for step in np.eye(2) * _STEP_NORM
        ]
        return np.asarray(scale @ np.stack(columns, axis=-1))


def _ahead(xyz_cam: Array) -> Array:
    """(N,) depths; NaN behind the camera."""
    return np.where(xyz_cam[:, 2] > 0, xyz_cam[:, 2], np.nan)
