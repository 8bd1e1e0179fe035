"""Frame rate of 2D pose files: as set, as the project or the videos next to them state it; never assumed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from posefuse.core import InputError, SourceError
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.session import Session, data_entries

from .images import frame_period_ns
from .pose2sim_project import read_project

# rates that differ by less are one rate: files round what cameras deliver
_SAME_SHARE = 0.01


def pose2d_rate_hz(session: Session, config: TrackConfig) -> float:
    """Frames per second of a session's 2D poses.

    The first of these that is known: ``rate_hz`` of the config (``--rate``), the ``Config.toml`` of a Pose2Sim project, the
    videos in the session's folder.

    Raises:
        InputError: none of them is known, or two videos have different rates.
    """
    if config.rate_hz is not None:
        return config.rate_hz
    project = read_project(session.folder)
    if project is not None and project.frame_rate_hz is not None:
        return project.frame_rate_hz
    rates = dict(_video_rates(session.folder))
    if not rates:
        raise InputError(
            f"{session.folder}: the 2D poses do not state their frame rate, and no video lies next to them; add `rate_hz=HZ`, "
            f"or rate_hz = HZ to {session.folder / 'posefuse.toml'}"
        )
    if max(rates.values()) > min(rates.values()) * (1 + _SAME_SHARE):
        different = ", ".join(f"{name} {rate:g} Hz" for name, rate in rates.items())
        raise InputError(f"{session.folder}: expected one frame rate, got {different}; add `rate_hz=HZ`")
    return float(np.median(list(rates.values())))


def _video_rates(folder: Path) -> Iterator[tuple[str, float]]:
    """Name and frame rate of each video of the session that can be read."""
    from posefuse.sources import VideoConfig

    for path in data_entries(folder, "videos"):
        try:
            times = np.asarray(VideoConfig(path, path.stem).build().times_ns())
        except SourceError:
            continue
        if (period_ns := frame_period_ns(times)) is not None:
            yield path.name, 1e9 / period_ns
