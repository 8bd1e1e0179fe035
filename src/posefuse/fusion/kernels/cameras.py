"""Cameras as rows of numbers, their columns by name, which numba takes as constants."""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np

from posefuse.core import Rig
from posefuse.core.arrays import Array
from posefuse.foundation.compiled import kernel

# sums may be contracted, but infinity and not-a-number keep their meaning
fast_kernel = partial(kernel, fastmath={"contract", "arcp", "nsz"})

# cam_from_world: rotation and translation by rows; optical centre in the world
R00, R01, R02, TX, R10, R11, R12, TY, R20, R21, R22, TZ = range(12)
X, Y, Z = 12, 13, 14


@lru_cache(maxsize=32)
def packed_rig(rig: Rig) -> Array:
    """(C, 15) float64, columns as above; the same array for the same rig, so do not write to it."""
    return np.stack([np.append(c.cam_from_world.matrix4()[:3], c.centre_world) for c in rig])
