"""Feet that stand: which points of them are at rest on the floor when, and where.

A point of a foot is in contact while it is slow and does not drift. During one stance it neither moves nor sinks: its place is
the mean over the stance.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import SIDES
from posefuse.kinematics.definitions import POINTS, landmark_pairs

from . import fit_kernels

SOLE, FOOT = ("heel", "toe"), ("ankle", "heel", "toe")
_SLOW_M_S = 0.25
# speed is measured from so long before to so long after: from frame to frame it is noise, the more the faster the cameras
_SPEED_OVER_S, _SAME_S = 0.1, 1e-3
_LEAST_S = 0.15
# from the first to the last third of a stance: what goes farther is a foot that moves slowly
_MOST_DRIFT_M, _MOST_DRIFT_M_S = 0.04, 0.15


def contacts_of(t_ns: Array, xyz: Array, cov: Array, skeleton: Skeleton, keypoint: Array) -> tuple[Array, Array]:
    """Contacts of one person's feet. World Z is up.

    Args:
        t_ns: (T,). xyz, cov: (T, A, 3), (T, A, 3, 3) keypoints, smoothed over time; NaN where unknown.
        keypoint: (A,) which of the skeleton they are.

    Returns:
        (T, A, 3) where they stand, NaN where they do not; and (T, A, 3, 3) of the error of these places, which all time steps of
        a stance share, for keypoints of feet that stand, elsewhere 0.
    """
    places, shared = np.full(xyz.shape, np.nan), np.zeros(cov.shape)
    for side in SIDES:
        foot = foot_rows(skeleton, keypoint, side, FOOT)
        for column in foot_rows(skeleton, keypoint, side, SOLE):
            track = xyz[:, column]
            for one in _stances(t_ns * 1e-9, track):
                places[one, column] = np.mean(track[one], axis=0)
                shared[one, foot] = np.mean(cov[one, foot], axis=0)
    return places, shared


def foot_rows(skeleton: Skeleton, keypoint: Array, side: str, names: tuple[str, ...]) -> list[int]:
    """Rows of the keypoints of the tree that are these landmarks of a foot."""
    pairs = landmark_pairs(skeleton)
    wanted = {int(k) for name in names for k in pairs[POINTS.index(f"{side}_{name}")] if k >= 0}
    return [row for row, k in enumerate(keypoint.tolist()) if k in wanted]


def _stances(t_s: Array, xyz: Array) -> Iterator[slice]:
    known = np.isfinite(xyz).all(axis=-1)
    if known.sum() < 3 or len(t_s) < 3:
        return
    stands = known & (np.nan_to_num(_speed_m_s(t_s, xyz), nan=np.inf) < _SLOW_M_S)
    for begin, end in np.flatnonzero(np.diff(np.concatenate([[0], stands.astype(int), [0]]))).reshape(-1, 2):
        third = max(1, (end - begin) // 3)
        drift = np.linalg.norm(xyz[end - third : end].mean(axis=0) - xyz[begin : begin + third].mean(axis=0))
        lasts_s = t_s[end - 1] - t_s[begin]
        if lasts_s >= _LEAST_S and drift < min(_MOST_DRIFT_M, _MOST_DRIFT_M_S * lasts_s * 2 / 3):
            yield slice(int(begin), int(end))


def _speed_m_s(t_s: Array, xyz: Array) -> Array:
    """(T,) mean speed about each time step, over its neighbours at least."""
    steps = np.arange(len(t_s))
    before = np.minimum(np.searchsorted(t_s, t_s - _SPEED_OVER_S - _SAME_S), np.maximum(steps - 1, 0))
    after = np.searchsorted(t_s, t_s + _SPEED_OVER_S + _SAME_S) - 1
    after = np.maximum(after, np.minimum(steps + 1, len(t_s) - 1))
    return np.asarray(np.linalg.norm(xyz[after] - xyz[before], axis=-1) / (t_s[after] - t_s[before]))


# Feet that stand, seen live: points of the sole that hardly move keep their place.

# speed of a standing point at most in m/s, and for how long at least in s; tracked points jump by millimetres with every view, so
# speed is a mean over 0.1 s; a point that is tracked 6 cm from its place does not stand; one that lifts is where it is tracked
# after a few times 0.05 s
_RULES = (0.5, 0.1, 0.1, 0.06, 0.05)


class StandingFeet:
    """Points of the soles of one person, in the order of times. Any direction may be up.

    Attributes:
        rows: (R,) which rows of the body's keypoints they are. stands: (R,) whether they stand.
    """

    def __init__(self, skeleton: Skeleton, keypoint: Array) -> None:
        self.rows = np.array([row for side in SIDES for row in foot_rows(skeleton, keypoint, side, SOLE)], np.intp)
        count = len(self.rows)
        self.stands = np.zeros(count, bool)
        self._t_ns: int | None = None
        self._last, self._place = np.full((2, count, 3), np.nan)
        self._off, self._velocity = np.zeros((2, count, 3))
        self._slow_s = np.zeros(count)

    def step(self, t_ns: int, xyz: Array) -> Array:
        """Where points that are tracked at (R, 3) are to be put."""
        elapsed_s = 0.0 if self._t_ns is None else (t_ns - self._t_ns) * 1e-9
        fit_kernels.stand(xyz, elapsed_s, _RULES, self._last, self._place, self._off, self._velocity, self._slow_s, self.stands)
        self._t_ns = t_ns
        return np.asarray(xyz + self._off)
