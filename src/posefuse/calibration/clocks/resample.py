"""Image points read at other moments than those of the frames."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array

# two frames further apart than this many periods are not interpolated between
_LONGEST_GAP_PERIODS = 2.2


def at_times(t_s: Array, values: Array, wanted_s: Array) -> Array:
    """Values (F, ..., D) known at rising t_s (F,), read at wanted_s (W,): (W, ..., D).

    Cubic between two neighbouring frames with the slopes of their neighbours (Catmull and Rom 1974), so that a wild frame does
    no harm beyond them. NaN outside and where a frame is missing; a frame at the moment asked for is given as it is.
    """
    if len(t_s) < 2:
        same = (wanted_s[:, None] == t_s).any(axis=1).reshape(-1, *[1] * (values.ndim - 1))
        return np.where(same, values[:1], np.nan)
    after = np.clip(np.searchsorted(t_s, wanted_s), 1, len(t_s) - 1)
    before = after - 1
    span = (t_s[after] - t_s[before]).reshape(-1, *[1] * (values.ndim - 1))
    share = (wanted_s - t_s[before]).reshape(span.shape) / span
    slopes = _slopes(t_s, values)
    p, q = values[before], values[after]
    line = (q - p) / span
    m, n = (np.where(np.isfinite(slopes[i]), slopes[i], line) for i in (before, after))
    curve = p + span * share * (m + share * ((3 * line - 2 * m - n) + share * (m + n - 2 * line)))
    reach = _LONGEST_GAP_PERIODS * float(np.median(np.diff(t_s)))
    inside = (share >= 0) & (share <= 1) & (span <= reach)
    curve = np.where(inside, curve, np.nan)
    # a neighbour that is missing does not matter at a frame's own moment
    return np.where(share == 0, p, np.where(share == 1, q, curve))


def _slopes(t_s: Array, values: Array) -> Array:
    """(F, ..., D) from each frame's neighbours; NaN where one is missing."""
    slopes = np.full(values.shape, np.nan)
    slopes[1:-1] = (values[2:] - values[:-2]) / (t_s[2:] - t_s[:-2]).reshape(-1, *[1] * (values.ndim - 1))
    return slopes
