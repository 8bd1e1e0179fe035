"""Feet that stand, seen live: points of the sole that hardly move keep their place."""

from __future__ import annotations

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.kinematics.sides import SIDES

from . import kernels
from .contacts import SOLE, foot_rows

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
        kernels.stand(xyz, elapsed_s, _RULES, self._last, self._place, self._off, self._velocity, self._slow_s, self.stands)
        self._t_ns = t_ns
        return np.asarray(xyz + self._off)
