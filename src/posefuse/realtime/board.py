"""What the fusion expects to be seen next, for all camera groups to read at any time without waiting."""

from __future__ import annotations

from dataclasses import dataclass
from multiprocessing.context import BaseContext
from typing import Any

import numpy as np

from posefuse.core import Pose3D
from posefuse.core.arrays import Array
from posefuse.tracking.online.settings import MOST_PEOPLE

_MOST_KEYPOINTS = 160
_TRIES = 8


@dataclass(frozen=True, eq=False)
class Expected:
    """The newest prediction.

    Attributes:
        t_ns: session time it is for; 0 when there is none yet.
        xyz_world: (N, K, 3) people followed; NaN where unknown.
        velocity_world: (N, K, 3) metres per second.
    """

    t_ns: int
    xyz_world: Array
    velocity_world: Array

    def at(self, t_ns: int) -> Array:
        """(N, K, 3) carried on to a time near it."""
        return np.asarray(self.xyz_world + self.velocity_world * ((t_ns - self.t_ns) / 1e9))


class Board:
    """Shared memory with one writer and many readers; a reader that meets a change in progress looks again."""

    def __init__(self, context: BaseContext) -> None:
        # revision (odd while being written), t_ns, people, keypoints
        self._words = context.RawArray("q", 4)
        self._numbers = context.RawArray("d", 2 * MOST_PEOPLE * _MOST_KEYPOINTS * 3)

    def write(self, pose: Pose3D, velocity_world: Array) -> None:
        """Replace what is there."""
        words, numbers = self._views()
        n, k = min(len(pose.person_id), MOST_PEOPLE), min(len(pose.skeleton), _MOST_KEYPOINTS)
        words[0] += 1
        words[1:] = pose.t_ns, n, k
        size = n * k * 3
        numbers[:size] = pose.xyz_world[:n, :k].ravel()
        numbers[size : 2 * size] = velocity_world[:n, :k].ravel()
        words[0] += 1

    def read(self) -> Expected:
        """The newest prediction; an empty one while there is none."""
        words, numbers = self._views()
        for _ in range(_TRIES):
            before, t_ns, n, k = (int(word) for word in words)
            copied = numbers[: 2 * n * k * 3].copy()
            if before % 2 == 0 and int(words[0]) == before:
                return Expected(t_ns, *copied.reshape(2, n, k, 3))
        return Expected(0, np.zeros((0, 0, 3)), np.zeros((0, 0, 3)))

    def _views(self) -> tuple[Any, Array]:
        return np.frombuffer(self._words, np.int64), np.frombuffer(self._numbers, np.float64)
