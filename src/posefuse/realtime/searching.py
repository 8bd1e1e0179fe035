"""When a camera's whole image is searched while no person is followed: when it changes, ever more rarely while it does not."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array

# a sampled pixel has changed when a channel differs by more than this: four standard deviations of the difference of two
# frames of a camera whose noise is 5 levels
_CHANGED_LEVELS = 30
# and so many pixels are a person far away, not a dead pixel
_CHANGED_PIXELS = 4
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.5, 10.0


class SearchSchedule:
    """Of one camera. No clock inside: times come as data.

    Only searches in vain make the next one wait. So a person who is found is searched in every frame, until enough cameras find
    them to follow them; one who is missed, in every frame that differs from the one before, or else after ten seconds.
    """

    def __init__(self) -> None:
        self._in_vain: Array | None = None
        self._next_s = self._wait_s = 0.0

    def due(self, sample: Array, now_s: float) -> bool:
        """Whether to search an image of which `sample` (h, w, 3) uint8 are some of the pixels."""
        return self._in_vain is None or now_s >= self._next_s or _differ(sample, self._in_vain)

    def searched(self, sample: Array, now_s: float, found: bool) -> None:
        """An image was searched; `found`: for a person."""
        if found:
            self._in_vain = None
            return
        changed = self._in_vain is None or _differ(sample, self._in_vain)
        self._wait_s = _FIRST_WAIT_S if changed else min(2 * self._wait_s, _LONGEST_WAIT_S)
        self._next_s, self._in_vain = now_s + self._wait_s, sample


def _differ(one: Array, other: Array) -> bool:
    apart = np.maximum(one, other) - np.minimum(one, other)
    return int((apart > _CHANGED_LEVELS).any(axis=-1).sum()) >= _CHANGED_PIXELS
