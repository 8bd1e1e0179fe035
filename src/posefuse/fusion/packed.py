"""A rig as one flat float64 array per camera, the form the compiled kernels read."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from posefuse.core import Camera, Rig
from posefuse.core.arrays import Array
from posefuse.core.lens import tilt_matrix

from .kernels import columns as at


@lru_cache(maxsize=32)
def packed_rig(rig: Rig) -> Array:
    """(C, WIDTH) float64, columns as in `kernels.columns`; the same array for the same rig, so do not write to it."""
    return np.stack([_packed_camera(camera) for camera in rig])


def _packed_camera(camera: Camera) -> Array:
    row = np.zeros(at.WIDTH)
    row[at.R00 : at.TX] = camera.cam_from_world.matrix().ravel()
    row[at.TX : at.FX] = camera.cam_from_world.xyz
    row[at.FX : at.K1] = [camera.K[0, 0], camera.K[0, 1], camera.K[0, 2], camera.K[1, 1], camera.K[1, 2]]
    row[at.K1 : at.K1 + min(12, len(camera.distortion))] = camera.distortion[:12]
    row[at.T00 : at.U00] = row[at.U00 : at.MODEL] = np.eye(3).ravel()
    if len(camera.distortion) == 14:
        tilt = tilt_matrix(float(camera.distortion[12]), float(camera.distortion[13]))
        row[at.T00 : at.U00] = tilt.ravel()
        row[at.U00 : at.MODEL] = np.linalg.inv(tilt).ravel()
    row[at.MODEL] = _model(camera)
    row[at.X : at.WIDTH] = camera.centre_world
    return row


def _model(camera: Camera) -> int:
    if not camera.distortion.any():
        return at.NO_LENS if camera.model == "pinhole" or len(camera.distortion) == 0 else at.FISHEYE
    if camera.model == "fisheye":
        return at.FISHEYE
    return at.BROWN_TILTED if len(camera.distortion) == 14 else at.BROWN
