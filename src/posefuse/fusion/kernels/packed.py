"""What the kernels of fusion share: cameras as rows of numbers, their columns by name, and how kernels are compiled.

Numba takes the columns as constants.
"""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np

from posefuse.core import Camera, Rig
from posefuse.core.arrays import Array
from posefuse.core.lens import tilt_matrix
from posefuse.foundation.compiled import kernel

# sums may be contracted, but infinity and not-a-number keep their meaning
fast_kernel = partial(kernel, fastmath={"contract", "arcp", "nsz"})

# cam_from_world: rotation by rows, translation
R00, R01, R02, R10, R11, R12, R20, R21, R22 = range(9)
TX, TY, TZ = 9, 10, 11
# intrinsic matrix
FX, SKEW, CX, FY, CY = 12, 13, 14, 15, 16
# distortion in the order of OpenCV; of a fisheye its four coefficients
K1, K2, P1, P2, K3, K4, K5, K6, S1, S2, S3, S4 = range(17, 29)
F1, F2, F3, F4 = K1, K2, P1, P2
# homography of a tilted sensor by rows, and its inverse
T00, T01, T02, T10, T11, T12, T20, T21, T22 = range(29, 38)
U00, U01, U02, U10, U11, U12, U20, U21, U22 = range(38, 47)
# one of the lens models below
MODEL = 47
# optical centre in the world
X, Y, Z = 48, 49, 50
WIDTH = 51

NO_LENS, BROWN, BROWN_TILTED, FISHEYE = 0, 1, 2, 3


@lru_cache(maxsize=32)
def packed_rig(rig: Rig) -> Array:
    """(C, WIDTH) float64, columns as above; the same array for the same rig, so do not write to it."""
    return np.stack([_packed_camera(camera) for camera in rig])


def _packed_camera(camera: Camera) -> Array:
    row = np.zeros(WIDTH)
    row[R00:TX] = camera.cam_from_world.matrix().ravel()
    row[TX:FX] = camera.cam_from_world.xyz
    row[FX:K1] = [camera.K[0, 0], camera.K[0, 1], camera.K[0, 2], camera.K[1, 1], camera.K[1, 2]]
    row[K1 : K1 + min(12, len(camera.distortion))] = camera.distortion[:12]
    row[T00:U00] = row[U00:MODEL] = np.eye(3).ravel()
    if len(camera.distortion) == 14:
        tilt = tilt_matrix(float(camera.distortion[12]), float(camera.distortion[13]))
        row[T00:U00] = tilt.ravel()
        row[U00:MODEL] = np.linalg.inv(tilt).ravel()
    row[MODEL] = _model(camera)
    row[X:WIDTH] = camera.centre_world
    return row


def _model(camera: Camera) -> int:
    if not camera.distortion.any():
        return NO_LENS if camera.model == "pinhole" or len(camera.distortion) == 0 else FISHEYE
    if camera.model == "fisheye":
        return FISHEYE
    return BROWN_TILTED if len(camera.distortion) == 14 else BROWN
