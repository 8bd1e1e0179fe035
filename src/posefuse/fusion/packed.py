"""A rig as one flat float64 array per camera, the form the compiled kernels read."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from posefuse.core import Camera, Rig
from posefuse.core.arrays import Array
from posefuse.core.lens import tilt_matrix

# columns of a packed camera; the kernels index them by these numbers
ROTATION, TRANSLATION, INTRINSIC, LENS, TILT, UNTILT, MODEL, CENTRE, WIDTH = 0, 9, 12, 17, 29, 38, 47, 48, 51
NO_LENS, BROWN, BROWN_TILTED, FISHEYE = 0, 1, 2, 3


@lru_cache(maxsize=32)
def packed_rig(rig: Rig) -> Array:
    """(C, WIDTH) float64; the same array for the same rig, so do not write to it."""
    return np.stack([_packed_camera(camera) for camera in rig])


def _packed_camera(camera: Camera) -> Array:
    row = np.zeros(WIDTH)
    row[ROTATION:TRANSLATION] = camera.cam_from_world.matrix().ravel()
    row[TRANSLATION:INTRINSIC] = camera.cam_from_world.xyz
    row[INTRINSIC:LENS] = [camera.K[0, 0], camera.K[0, 1], camera.K[0, 2], camera.K[1, 1], camera.K[1, 2]]
    row[LENS : LENS + min(12, len(camera.distortion))] = camera.distortion[:12]
    row[TILT:UNTILT] = row[UNTILT:MODEL] = np.eye(3).ravel()
    if len(camera.distortion) == 14:
        tilt = tilt_matrix(float(camera.distortion[12]), float(camera.distortion[13]))
        row[TILT:UNTILT] = tilt.ravel()
        row[UNTILT:MODEL] = np.linalg.inv(tilt).ravel()
    row[MODEL] = _model(camera)
    row[CENTRE:WIDTH] = camera.centre_world
    return row


def _model(camera: Camera) -> int:
    if not camera.distortion.any():
        return NO_LENS if camera.model == "pinhole" or len(camera.distortion) == 0 else FISHEYE
    if camera.model == "fisheye":
        return FISHEYE
    return BROWN_TILTED if len(camera.distortion) == 14 else BROWN
