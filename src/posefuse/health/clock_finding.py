"""How far the stamps of cameras are apart, from a person who moves in front of them; cheap enough for a busy machine.

Paths of the person's points and offsets are sought together (Gauss-Newton, `calibrate.sync_paths`). Every block of new seconds
is looked at once; what it says is added to what earlier ones said, which fades.
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
from posefuse.calibration.keypoints import MIN_SCORE
from posefuse.core import Rig
from posefuse.core.arrays import Array

# new seconds looked at in one go, the longest looked at when more have come, and what is looked at again at both ends
_BLOCK_S, _LONGEST_S, _MARGIN_S = 2.0, 6.0, 0.3
_FAR_S, _FAR_SIGMAS = 0.02, 5.0
# of all cameras' offsets before anything is seen
_BEFORE_S = 0.3
_FORGOTTEN_S, _TRUSTED_S = 20.0, 0.005


class ClockFinder:
    """Offsets of all cameras' stamps about their mean; feed it views, ask it now and then."""

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
        self._newest_s[c] = t_s
        xy = np.where((score >= MIN_SCORE)[:, None], self._rig.cameras[c].norm_from_px(xy_img), np.nan)
        self._views.append((c, t_s, xy))
        while self._views[0][1] < t_s - _LONGEST_S - 2 * _MARGIN_S:
            self._views.popleft()

    def cut(self) -> None:
        """What comes next does not go on from what came: nothing is compared across."""
        self._views.clear()

    def find(self) -> dict[str, float] | None:
        """Offset of each camera that is known well enough; None while there is nothing new."""
        heard = [s for s in self._newest_s if np.isfinite(s)]
        if len(heard) < 2:
            return None
        end_s = float(np.median(heard)) - _MARGIN_S
        begin_s = max(self._done_s, end_s - _LONGEST_S)
        if end_s - begin_s < _BLOCK_S:
            return None
        fade = np.exp(-(end_s - self._done_s) / _FORGOTTEN_S) if self._done_s else 1.0
        self._done_s = end_s
        views = self._between(begin_s - _MARGIN_S, end_s + _MARGIN_S)
        nothing = ClockSums(np.zeros_like(self._sums.information), np.zeros_like(self._sums.pull))
        before = ClockSums(fade * self._sums.information, fade * self._sums.pull)
        if (told := _told(self._rig, views, self._offset_s, before)) is not None:
            if _elsewhere(told, self._offset_s):
                # a clock that was set, or the first look: paths were wrong, so this block only says where to begin
                told = _told(self._rig, views, self._offset_s, nothing) or told
                self._sums, self._offset_s = nothing, _settled(told)
            else:
                self._sums = before.and_also(told)
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
    """Information that holds the mean of all offsets at 0, and each about there before anything is seen."""
    return np.ones((count, count)) / (count * _TRUSTED_S) ** 2 + np.eye(count) / _BEFORE_S**2


def _settled(sums: ClockSums) -> Array:
    offset_s = np.linalg.solve(sums.information + _only_differences(len(sums.pull)), sums.pull)
    return np.asarray(offset_s - offset_s.mean())


def _elsewhere(told: ClockSums, offset_s: Array) -> bool:
    """Whether offsets are clearly far from where they were looked for."""
    sigma_s = np.sqrt(np.diag(np.linalg.inv(told.information + _only_differences(len(offset_s)))))
    return bool((np.abs(_settled(told) - offset_s) > np.maximum(_FAR_S, _FAR_SIGMAS * sigma_s)).any())


def _told(rig: Rig, views: MovingViews, offset_s: Array, before: ClockSums) -> ClockSums | None:
    """What the views say of the offsets, looked for about `offset_s` and what was known `before`; None when there are too few."""
    if sum(np.bincount(views.c, minlength=len(rig)) >= LEAST_VIEWS) < 2:
        return None
    paths = Paths(rig, views)
    for acceleration in ACCELERATIONS_M_S2:
        told = paths.step(offset_s, acceleration)
        told = ClockSums(told.information, told.pull + told.information @ offset_s)
        moved_s = np.clip(_settled(before.and_also(told)) - offset_s, -LONGEST_STEP_S, LONGEST_STEP_S)
        offset_s = offset_s + moved_s
        if acceleration == ACCELERATIONS_M_S2[-1] and np.abs(moved_s).max() < SETTLED_S:
            break
    return told
