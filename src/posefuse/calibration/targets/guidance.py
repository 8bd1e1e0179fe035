"""What is still missing while a target is being waved: a pure function of what has been seen so far."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.core.arrays import Array

from .coverage import CELLS_WH, Coverage, linked_groups

# free-running cameras show the same moment within this time
_SAME_MOMENT_NS = 60_000_000
# every camera of examples/scenes/calibration_cube_8cam.yaml, which comes out to 2 mm, covers more than this
_ENOUGH_SHARE, _ENOUGH_TOGETHER = 0.25, 30


@dataclass(frozen=True, eq=False)
class Guidance:
    """What has been seen.

    Attributes:
        coverage: frames per image region, and moments per pair of cameras.
        last_ns: (C,) when each camera saw the target last; -1 before the first time.
    """

    coverage: Coverage
    last_ns: Array

    @property
    def covered(self) -> Array:
        """(C,) from 0 to 1, enough: how far each camera's image is covered."""
        return np.minimum(1.0, self.coverage.share / _ENOUGH_SHARE)

    @property
    def linked(self) -> Array:
        """(C, C) from 0 to 1, enough: how far two cameras have seen the target together."""
        return np.minimum(1.0, self.coverage.together / _ENOUGH_TOGETHER)

    @property
    def enough(self) -> bool:
        """Every camera has met the target in much of its image, and all hang together by many moments."""
        return len(linked_groups(self.linked >= 1)) == 1 and bool((self.covered >= 1).all())

    @property
    def words(self) -> str:
        """What to do next."""
        return "enough: stop waving and calibrate" if self.enough else self.coverage.advice()


def start(cameras: tuple[str, ...]) -> Guidance:
    """Nothing seen yet."""
    count, (columns, rows) = len(cameras), CELLS_WH
    nothing = Coverage(cameras, np.zeros((count, rows, columns)), np.zeros((count, count)))
    return Guidance(nothing, np.full(count, -1, np.int64))


def seen(guidance: Guidance, camera: int, t_ns: int, xy_img: Array, size_wh: tuple[int, int]) -> Guidance:
    """With one more frame of camera number `camera`, which shows corners (n, 2) px; n = 0 changes nothing."""
    if len(xy_img) == 0:
        return guidance
    cells, together = guidance.coverage.cells.copy(), guidance.coverage.together.copy()
    column, row = np.unique(np.clip(((xy_img + 0.5) / size_wh * CELLS_WH).astype(np.int64), 0, np.array(CELLS_WH) - 1), axis=0).T
    cells[camera, row, column] += 1
    others = (guidance.last_ns >= 0) & (np.abs(guidance.last_ns - t_ns) <= _SAME_MOMENT_NS)
    others[camera] = False
    together[camera, camera] += 1
    together[camera, others] += 1
    together[others, camera] += 1
    last = guidance.last_ns.copy()
    last[camera] = t_ns
    return replace(guidance, coverage=Coverage(guidance.coverage.cameras, cells, together), last_ns=last)
