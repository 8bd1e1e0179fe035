"""Latency, measured per camera and stage: counts in fixed bins, so an hour costs no more memory than a second.

The latency bound is what is not waited for: `Capture.put` (`realtime.capture`) keeps the newest waiting frame of a camera alone,
`Fusion.run` (`realtime.fusion_loop`) puts out each pose when it is due, without the views that are not there, and skips ticks
that it missed, and the tracker (`tracking.online.admission`) takes no view that is older than its memory.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

STAGES = ("capture", "wait", "2D", "fuse", "output", "total")
QUANTILES = (0.5, 0.95, 0.99)
_BIN_MS = 0.1
_BINS = 20_000
_NEWEST = 4096


class Histogram:
    """Durations in bins of 0.1 ms up to 2 s; longer ones count in the last bin."""

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS, np.int64)
        self._highest = self.count = 0
        self._sum_ms = 0.0
        self.most_ms = 0.0

    def add(self, ms: float) -> None:
        """Count one; negative ones (two clocks that disagree a little) count as 0."""
        ms = max(ms, 0.0)
        place = min(int(ms / _BIN_MS), _BINS - 1)
        self._counts[place] += 1
        self._highest = max(self._highest, place)
        self.count += 1
        self._sum_ms += ms
        self.most_ms = max(self.most_ms, ms)

    def quantile_ms(self, share: float) -> float:
        """Upper edge of the bin in which that share is reached; NaN when nothing was counted."""
        if not self.count:
            return float("nan")
        place = int(np.searchsorted(np.cumsum(self._counts[: self._highest + 1]), share * self.count))
        return min((place + 1) * _BIN_MS, self.most_ms)

    def figures(self) -> dict[str, float]:
        """mean, quantiles and maximum in ms."""
        mean = self._sum_ms / self.count if self.count else float("nan")
        found = {f"p{round(100 * share)}": self.quantile_ms(share) for share in QUANTILES}
        return {"n": self.count, "mean": mean, **found, "max": self.most_ms if self.count else float("nan")}


@dataclass(frozen=True)
class ViewTimes:
    """When one view passed each stage, session ns: exposure, reached its process, 2D began, 2D done, in the tracker."""

    camera: str
    exposed_ns: int
    received_ns: int
    started_ns: int
    detected_ns: int
    fused_ns: int


@dataclass
class Latencies:
    """Of every camera's views, and of the output's output tick."""

    cameras: Iterable[str]
    ticks: Histogram = field(default_factory=Histogram)
    late_ticks: int = 0

    def __post_init__(self) -> None:
        self.stages = {name: {stage: Histogram() for stage in STAGES} for name in self.cameras}
        self.whole = Histogram()
        # newest views, and when their outputs went out, session ns
        self.newest: deque[tuple[ViewTimes, int]] = deque(maxlen=_NEWEST)
        self.periods = Histogram()
        self._first_out_ns: int | None = None
        self._last_out_ns: int | None = None

    @property
    def rate_hz(self) -> float:
        """Outputs per second."""
        if self._first_out_ns is None or self._last_out_ns is None or self.ticks.count < 2:
            return float("nan")
        return (self.ticks.count - 1) * 1e9 / (self._last_out_ns - self._first_out_ns)

    def view_out(self, way: ViewTimes, output_ns: int) -> None:
        """The first output that rests on this view has gone out."""
        times = (way.exposed_ns, way.received_ns, way.started_ns, way.detected_ns, way.fused_ns, output_ns)
        spans_ms = [(after - before) / 1e6 for before, after in itertools.pairwise(times)]
        total_ms = (output_ns - way.exposed_ns) / 1e6
        for stage, ms in zip(STAGES, (*spans_ms, total_ms), strict=True):
            self.stages[way.camera][stage].add(ms)
        self.whole.add(total_ms)
        self.newest.append((way, output_ns))

    def tick_out(self, due_ns: int, output_ns: int, period_ns: int) -> None:
        """One output went out that was due at `due_ns`."""
        self.ticks.add((output_ns - due_ns) / 1e6)
        if self._last_out_ns is not None:
            self.periods.add(abs(output_ns - self._last_out_ns - period_ns) / 1e6)
        else:
            self._first_out_ns = output_ns
        self._last_out_ns = output_ns

    def figures(self) -> dict[str, Any]:
        """Plain values in ms."""
        return {
            "all_cameras_total_ms": self.whole.figures(),
            "cameras_ms": {
                name: {stage: histogram.figures() for stage, histogram in stages.items()} for name, stages in self.stages.items()
            },
            "output": {
                "behind_due_ms": self.ticks.figures(),
                "period_deviation_ms": self.periods.figures(),
                "skipped": self.late_ticks,
            },
        }
