"""Cameras as rows of numbers, their columns by name, which numba takes as constants."""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np

from posefuse.core import Rig
from posefuse.core.arrays import Array
from posefuse.foundation.compiled import kernel

# sums may be contracted, but infinity and not-a-number keep their meaning
fast_kernel = partial(kernel, fastmath={"contract", "arcp", "nsz"})

# cam_from_world: rotation by rows, translation; optical centre in the world
R00, R01, R02, R10, R11, R12, R20, R21, R22 = range(9)
TX, TY, TZ = 9, 10, 11
X, Y, Z = 12, 13, 14


@lru_cache(maxsize=32)
def packed_rig(rig: Rig) -> Array:
    """(C, 15) float64, columns as above; the same array for the same rig, so do not write to it."""
    return np.stack([np.concatenate([c.cam_from_world.matrix().ravel(), c.cam_from_world.xyz, c.centre_world]) for c in rig])
