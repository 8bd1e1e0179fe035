"""The columns of `core.rig.packed_rig` by name, which numba takes as constants."""

from __future__ import annotations

from functools import partial

from posefuse.foundation.compiled import kernel

# sums may be contracted, but infinity and not-a-number keep their meaning
fast_kernel = partial(kernel, fastmath={"contract", "arcp", "nsz"})

# cam_from_world: rotation and translation by rows; optical centre in the world
R00, R01, R02, TX, R10, R11, R12, TY, R20, R21, R22, TZ = range(12)
X, Y, Z = 12, 13, 14
