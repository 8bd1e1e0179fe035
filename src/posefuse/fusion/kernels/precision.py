"""How kernels of fusion are compiled: sums may be contracted, but infinity and not-a-number keep their meaning."""

from __future__ import annotations

import functools

from posefuse.foundation.compiled import kernel

fast_kernel = functools.partial(kernel, fastmath={"contract", "arcp", "nsz"})
