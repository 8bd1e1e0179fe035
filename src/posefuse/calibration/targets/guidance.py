"""What is still missing while a target is being waved: a pure function of what has been seen so far."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.core.arrays import Array

from .coverage import CELLS_WH, ENOUGH_SHARE, ENOUGH_TOGETHER, SAME_MOMENT_NS, TargetCoverage

# before the first frame; times may be negative, and differences of two must not overflow
_NEVER_NS = -(2**61)


@dataclass(frozen=True, eq=False)
class Guidance:
    """What has been seen.

    Attributes:
        coverage: frames per image region, and moments per pair of cameras.
        last_ns: (C,) when each camera saw the target last; `_NEVER_NS` before the first time.
        shared_ns: (C, C) newest frame of either of two cameras that was counted as a moment of both.
    """

    coverage: TargetCoverage
    last_ns: Array
    shared_ns: Array

    @property
    def covered(self) -> Array:
        """(C,) from 0 to 1, enough: how far each camera's image is covered."""
        return np.minimum(1.0, self.coverage.share / ENOUGH_SHARE)

    @property
    def linked(self) -> Array:
        """(C, C) from 0 to 1, enough: how far two cameras have seen the target together."""
        return np.minimum(1.0, self.coverage.together / ENOUGH_TOGETHER)

    @property
    def enough(self) -> bool:
        """See `TargetCoverage.enough`."""
        return self.coverage.enough

    @property
    def words(self) -> str:
        """What to do next."""
        return self.coverage.advice()


def new_guidance(cameras: tuple[str, ...]) -> Guidance:
    """Nothing seen yet."""
    count, (columns, rows) = len(cameras), CELLS_WH
    nothing = TargetCoverage(cameras, np.zeros((count, rows, columns)), np.zeros((count, count)))
    return Guidance(nothing, np.full(count, _NEVER_NS), np.full((count, count), _NEVER_NS))


def seen(guidance: Guidance, camera: int, t_ns: int, xy_img: Array, size_wh: tuple[int, int]) -> Guidance:
    """With one more frame of camera number `camera`, which shows corners (n, 2) px; n = 0 changes nothing."""
    if len(xy_img) == 0:
        return guidance
    cells, together = guidance.coverage.cells.copy(), guidance.coverage.together.copy()
    column, row = np.unique(np.clip(((xy_img + 0.5) / size_wh * CELLS_WH).astype(np.int64), 0, np.array(CELLS_WH) - 1), axis=0).T
    cells[camera, row, column] += 1
    last, shared = guidance.last_ns.copy(), guidance.shared_ns.copy()
    # a frame pairs with one frame of another camera, not with that before and that after it
    others = (np.abs(last - t_ns) <= SAME_MOMENT_NS) & (np.minimum(last, t_ns) > shared[camera])
    others[camera] = False
    together[camera, camera] += 1
    together[camera, others] += 1
    together[others, camera] += 1
    shared[camera, others] = shared[others, camera] = np.maximum(last[others], t_ns)
    last[camera] = t_ns
    return replace(guidance, coverage=TargetCoverage(guidance.coverage.cameras, cells, together), last_ns=last, shared_ns=shared)
