"""Time steps for the frames of a live session: cameras that run freely, and of which not every frame was used."""

from __future__ import annotations

from posefuse.core import InputError, Observations
from posefuse.core.observations import camera_times

from .config import TrackConfig
from .images import Timeline, common_timeline


def live_timeline(observations: Observations, config: TrackConfig) -> Timeline:
    """Even time steps at the fastest camera's rate (or `config.rate_hz`), see `common_timeline`.

    Raises:
        InputError: no frame.
        SourceError: nothing between start and end, or more time steps than a recording can have.
    """
    times = camera_times(observations)
    if not times:
        raise InputError("live recording: it holds no detections; there is nothing to solve")
    return common_timeline(times, config.rate_hz, config.start_s, config.end_s)
