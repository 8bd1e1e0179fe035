"""Views of cameras that do not wait for each other, read at common time steps."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from itertools import pairwise

import numpy as np

from posefuse.core.arrays import Array

_PERIOD_NS = 100_000_000
# a time step is given when views this much newer are there: those of a slower camera should have come
_PATIENCE_NS = 500_000_000
# two views of a camera further apart than this are not interpolated between: a hand leaves the straight line by centimetres
_REACH_NS = 125_000_000
# after a gap this long time steps continue where views do
_GAP_NS = 2_000_000_000
_MOST_VIEWS = 256


class CommonTimeSteps:
    """Every camera's points at ten time steps a second, linear between its views on both sides."""

    def __init__(self, cameras: Iterable[str]) -> None:
        self._views: dict[str, deque[tuple[int, Array]]] = {name: deque(maxlen=_MOST_VIEWS) for name in cameras}
        self._next_ns: int | None = None

    def add(self, camera: str, t_ns: int, xy_img: Array, seen: Array) -> None:
        """One view's points (P, 2), of which those `seen` (P,) count; one that is older than the camera's newest does not."""
        views = self._views[camera]
        if views and t_ns <= views[-1][0]:
            # a clock that was set back starts again
            if t_ns < views[-1][0] - _GAP_NS:
                views.clear()
            else:
                return
        views.append((t_ns, np.where(seen[:, None], xy_img, np.nan)))

    def ready(self) -> Iterator[tuple[int, Array]]:
        """Time steps that no view can change any more: time, and points (C, P, 2), NaN where a camera has none."""
        newest = sorted(views[-1][0] for views in self._views.values() if views)
        if len(newest) < 2:
            return
        # one camera that is ahead of all others does not push them
        last_ns = newest[-2] - _PATIENCE_NS
        if self._next_ns is None or abs(last_ns - self._next_ns) > _GAP_NS:
            self._next_ns = last_ns - last_ns % _PERIOD_NS
        while self._next_ns <= last_ns:
            t_ns, self._next_ns = self._next_ns, self._next_ns + _PERIOD_NS
            read = [_at(views, t_ns) for views in self._views.values()]
            points = next((xy for xy in read if xy is not None), None)
            if points is not None:
                yield t_ns, np.stack([np.full(points.shape, np.nan) if xy is None else xy for xy in read])


def _at(views: deque[tuple[int, Array]], t_ns: int) -> Array | None:
    while len(views) > 1 and views[1][0] <= t_ns:
        views.popleft()
    for (before_ns, before), (after_ns, after) in pairwise(list(views)[:2]):
        if before_ns <= t_ns < after_ns <= before_ns + _REACH_NS:
            share = (t_ns - before_ns) / (after_ns - before_ns)
            return np.asarray(before + share * (after - before))
    return None
