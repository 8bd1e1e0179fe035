"""Clock offsets of cameras from a person who moves in front of them; cheap enough for a busy machine.

Paths of the person's points and offsets are estimated together (Gauss-Newton, `calibration.clocks.paths`). Every block of new
seconds is used once; its normal equations are added to those of earlier blocks, which fade exponentially.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from posefuse.calibration.clocks.paths import (
    ACCELERATIONS_M_S2,
    APART_S,
    LEAST_VIEWS,
    LONGEST_STEP_S,
    SETTLED_S,
    ClockSums,
    MovingViews,
    Paths,
)
from posefuse.calibration.clocks.person_tracks import MIN_SCORE
from posefuse.core import Rig
from posefuse.core.arrays import Array

# a block of new seconds, the longest one when more have come, and the overlap at both ends
_BLOCK_S, _LONGEST_S, _MARGIN_S = 2.0, 6.0, 0.3
# offsets both so far and so many standard errors from where they were searched are of clocks that were set (four clips, a clock
# set by 50 ms: known to 10 ms within 5 s; with 5 standard errors not within 24 s)
_FAR_S, _FAR_SIGMAS = 0.02, 3.0
# prior standard deviation of every offset
_BEFORE_S = 0.3
# chosen, not fitted: time constant at which earlier blocks fade: a clock that was set is followed sooner with less, and an offset
# that stays is known better with more; and the standard error below which an offset is reported
_FORGOTTEN_S, _TRUSTED_S = 20.0, 0.005


class ClockFinder:
    """Clock offsets of all cameras about their mean: `add` every view, call `find` now and then."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._place = {name: c for c, name in enumerate(rig.names)}
        self._views: deque[tuple[int, float, Array]] = deque()
        self._newest_s = [-np.inf] * len(rig)
        self._zero_ns: int | None = None
        self._done_s = 0.0
        self._sums = ClockSums(np.zeros((len(rig), len(rig))), np.zeros(len(rig)))
        self._offset_s = np.zeros(len(rig))

    def add(self, camera: str, t_ns: int, xy_img: Array, score: Array) -> None:
        """One person's points (P, 2) in a view with their scores (P,)."""
        self._zero_ns = t_ns if self._zero_ns is None else self._zero_ns
        c, t_s = self._place[camera], (t_ns - self._zero_ns) / 1e9
        if t_s < self._newest_s[c] + APART_S:
            return
        xy = np.where((score >= MIN_SCORE)[:, None], self._rig.cameras[c].norm_from_px(xy_img), np.nan)
        if not np.isfinite(xy).any():
            return
        self._newest_s[c] = t_s
        self._views.append((c, t_s, xy))
        while self._views[0][1] < t_s - _LONGEST_S - 2 * _MARGIN_S:
            self._views.popleft()

    def find(self) -> dict[str, float] | None:
        """Offset in s of each camera that is known well enough; None while there is nothing new."""
        newest_s = [s for s in self._newest_s if np.isfinite(s)]
        if len(newest_s) < 2:
            return None
        end_s = float(np.median(newest_s)) - _MARGIN_S
        begin_s = max(self._done_s, end_s - _LONGEST_S)
        if end_s - begin_s < _BLOCK_S:
            return None
        fade = np.exp(-(end_s - self._done_s) / _FORGOTTEN_S) if self._done_s else 1.0
        self._done_s = end_s
        views = self._between(begin_s - _MARGIN_S, end_s + _MARGIN_S)
        nothing = ClockSums(np.zeros_like(self._sums.information), np.zeros_like(self._sums.pull))
        before = ClockSums(fade * self._sums.information, fade * self._sums.pull)
        if (sums := _sums_of(self._rig, views, self._offset_s, before)) is not None:
            if _elsewhere(sums, self._offset_s):
                # a clock that was set: earlier blocks are of another one (kept, it is off by 190 ms after one of 300 ms)
                before, sums = nothing, _sums_of(self._rig, views, self._offset_s, nothing) or sums
            self._sums = before.and_also(sums)
            self._offset_s = _settled(self._sums)
        return self._known()

    def _between(self, begin_s: float, end_s: float) -> MovingViews:
        inside = [view for view in self._views if begin_s <= view[1] - self._offset_s[view[0]] <= end_s]
        return MovingViews(
            np.array([c for c, _, _ in inside], np.intp),
            np.array([t_s for _, t_s, _ in inside]),
            np.array([xy for _, _, xy in inside]),
        )

    def _known(self) -> dict[str, float]:
        spread = np.sqrt(np.diag(np.linalg.inv(self._sums.information + _only_differences(len(self._rig)))))
        sure = [name for name, sigma_s in zip(self._rig.names, spread, strict=True) if sigma_s < _TRUSTED_S]
        return {name: float(self._offset_s[self._place[name]]) for name in sure} if len(sure) > 1 else {}


def _only_differences(count: int) -> Array:
    """Prior information: the mean of all offsets is 0, and each is near 0."""
    return np.ones((count, count)) / (count * _TRUSTED_S) ** 2 + np.eye(count) / _BEFORE_S**2


def _settled(sums: ClockSums) -> Array:
    offset_s = np.linalg.solve(sums.information + _only_differences(len(sums.pull)), sums.pull)
    return np.asarray(offset_s - offset_s.mean())


def _elsewhere(sums: ClockSums, offset_s: Array) -> bool:
    """Whether the offsets are clearly far from where they were searched."""
    sigma_s = np.sqrt(np.diag(np.linalg.inv(sums.information + _only_differences(len(offset_s)))))
    return bool((np.abs(_settled(sums) - offset_s) > np.maximum(_FAR_S, _FAR_SIGMAS * sigma_s)).any())


def _sums_of(rig: Rig, views: MovingViews, offset_s: Array, before: ClockSums) -> ClockSums | None:
    """Normal equations of the views for the offsets, searched near `offset_s`; None when there are too few views."""
    if sum(np.bincount(views.c, minlength=len(rig)) >= LEAST_VIEWS) < 2:
        return None
    paths = Paths(rig, views)
    for acceleration in ACCELERATIONS_M_S2:
        sums = paths.step(offset_s, acceleration)
        sums = ClockSums(sums.information, sums.pull + sums.information @ offset_s)
        moved_s = np.clip(_settled(before.and_also(sums)) - offset_s, -LONGEST_STEP_S, LONGEST_STEP_S)
        offset_s = offset_s + moved_s
        if acceleration == ACCELERATIONS_M_S2[-1] and np.abs(moved_s).max() < SETTLED_S:
            break
    return sums
