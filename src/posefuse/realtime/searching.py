"""When a camera's whole image is searched while no person is followed: when it changes, ever more rarely while it does not."""

from __future__ import annotations

import cv2
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
        """Whether to search. sample: (h, w, 3) uint8 some of the image's pixels. now_s: the time."""
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
    apart = cv2.absdiff(one, other) > _CHANGED_LEVELS
    # mostly there are hardly any: not worth going through the channels
    return int(np.count_nonzero(apart)) >= _CHANGED_PIXELS and int(apart.any(axis=-1).sum()) >= _CHANGED_PIXELS


def search_slot(now_ns: int, every_s: float) -> int:
    """The number of the stretch of time in which every camera searches its whole image once, at its first look.

    It is the same for all cameras: a new person is found where two of them see them at about the same time.
    """
    return now_ns // round(every_s * 1e9)
