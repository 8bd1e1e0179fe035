"""Velocities of what is published, from one step to the next: differences, smoothed over some hundredths of a second."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from posefuse.core import SE3
from posefuse.core.arrays import Array

from .parts import small_turn

Difference = Callable[[Array, Array], Array]

# a step of 10 ms corrected by a new view is uncertain by itself
SMOOTHED_S = 0.08
_GAP_S = 0.3


class Velocities:
    """Rates of change per person. Values (N, V), given as differences, so that angles may wrap; NaN until two steps are known."""

    def __init__(self, smoothed_s: float = SMOOTHED_S) -> None:
        self._smoothed_s = smoothed_s
        self._t_ns: int | None = None
        self._before: dict[int, tuple[Array, Array]] = {}

    def step(self, t_ns: int, people: Sequence[int], values: Array, difference: Difference) -> Array:
        """(N, D) per second, at the time of the newest values (N, V); `difference(now, before)` is (D,)."""
        dt = (t_ns - self._t_ns) / 1e9 if self._t_ns is not None else np.inf
        went_on = 0.0 < dt < _GAP_S
        weight = 1.0 - np.exp(-dt / self._smoothed_s) if went_on else 1.0
        found, kept = [], {}
        for person, now in zip(people, values, strict=True):
            before = self._before.get(person)
            if before is None or not went_on:
                rate = np.full(len(difference(now, now)), np.nan)
            else:
                raw = difference(now, before[0]) / dt
                # what is new begins with its first difference
                rate = np.where(np.isfinite(before[1]), before[1] + weight * (raw - before[1]), raw)
            kept[person] = now, rate
            found.append(rate)
        self._t_ns, self._before = t_ns, kept
        return np.array(found)


def angle_difference(now: Array, before: Array) -> Array:
    """Of angles (V,) in rad, the shorter way round."""
    return np.asarray((now - before + np.pi) % (2 * np.pi) - np.pi)


def pose_difference(now: Array, before: Array) -> Array:
    """Of poses (P * 7,), wxyz and xyz of each: metres and a rotation vector about the world's axes, (P * 6,)."""
    one, other = now.reshape(-1, 7), before.reshape(-1, 7)
    return np.concatenate([one[:, 4:] - other[:, 4:], small_turn(one[:, :4], other[:, :4])], axis=-1).ravel()


def packed_poses(poses: SE3) -> Array:
    """(N, P * 7) of a batch (N, P), as `pose_difference` takes them."""
    both = np.concatenate([poses.wxyz, poses.xyz], axis=-1)
    return np.asarray(both.reshape(len(both), -1))
