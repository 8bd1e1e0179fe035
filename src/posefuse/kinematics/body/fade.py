"""From one source of a pose to another without a step: for a while it lies between both."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array


class Fade:
    """Corrections of one person's tracked keypoints (K, 3), in metres, in the order of times."""

    def __init__(self, count: int, duration_s: float) -> None:
        self._last, self._left = np.zeros((2, count, 3))
        self._duration_ns, self._changed_ns = duration_s * 1e9, 0

    def step(self, t_ns: int, wanted: Array, changed: bool) -> Array:
        """The correction at this time, between the wanted one and the last of the source before it.

        When the source has just `changed` it is the same as at the last time step.
        """
        if changed:
            self._left, self._changed_ns = self._last, t_ns
        passed = min((t_ns - self._changed_ns) / self._duration_ns, 1.0)
        # velocity does not step, either
        share = passed * passed * (3.0 - 2.0 * passed)
        self._last = self._left + share * (wanted - self._left)
        return self._last

    def over(self, t_ns: int) -> bool:
        """Whether the wanted correction is reached."""
        return t_ns - self._changed_ns >= self._duration_ns
