"""Time steps for the frames of a live session: cameras that run freely, and of which not every frame was used."""

from __future__ import annotations

import numpy as np

from posefuse.core import InputError, Observations
from posefuse.core.arrays import Array
from posefuse.core.live_observations import camera_times

from .config import TrackConfig
from .images import Timeline, common_timeline

# dropped frames leave gaps of whole periods: the smallest tenth of a camera's gaps has none
_WHOLE_SHARE = 0.1


def live_timeline(observations: Observations, config: TrackConfig) -> Timeline:
    """Even time steps at the fastest camera's rate (or `config.rate_hz`), see `common_timeline`.

    Raises:
        InputError: no frame.
        SourceError: nothing between start and end, or more time steps than `config` allows.
    """
    times = camera_times(observations)
    if not times:
        raise InputError("live recording: it holds no detections; there is nothing to solve")
    periods_ns = [period_ns for t_ns in times.values() if (period_ns := frame_period_ns(t_ns)) is not None]
    rate_hz = config.rate_hz or (1e9 / min(periods_ns) if periods_ns else None)
    return common_timeline(times, rate_hz, config.start_s, config.end_s, max_time_steps=config.max_time_steps)


def frame_period_ns(t_ns: Array) -> float | None:
    """The time from frame to frame of a camera of which some frames are missing; None for fewer than two frames."""
    gaps = np.diff(t_ns).astype(np.float64)
    if not len(gaps):
        return None
    period = float(np.quantile(gaps, _WHOLE_SHARE))
    # twice: the second time with a period that is known well enough to count the frames of longer gaps
    for _ in range(2):
        whole = np.maximum(np.round(gaps / period), 1)
        period = float(np.median(gaps / whole))
    count = np.concatenate([[0], np.cumsum(np.maximum(np.round(gaps / period), 1))])
    return float(np.polyfit(count, (t_ns - t_ns[0]).astype(np.float64), 1)[0]) if len(gaps) > 1 else period
