"""Time steps of videos and image folders: decoded ahead, detected when asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.core import (
    Detections2D,
    Detector,
    Frame,
    JointCentres,
    LookKind,
    Observations,
    Pose3D,
    Region,
    Rig,
    Skeleton,
    SourceError,
)
from posefuse.core.arrays import Array
from posefuse.detection import region_from_pose, with_clothing, with_depth
from posefuse.sources import CountedSource, FramesAhead, RecordedSource, frame_sets, incomplete_cameras

# of a recording: 18 hours at 30 Hz; more are those of a damaged time or a wrong rate
_MOST_TIME_STEPS = 2_000_000
# dropped frames leave gaps of whole periods: the smallest tenth of a camera's gaps has none
_WHOLE_SHARE = 0.1


@dataclass(frozen=True)
class Timeline:
    """Evenly spaced time steps: start_ns + i * period_ns for i < count."""

    start_ns: int
    period_ns: int
    count: int

    def t_ns(self, i: int) -> int:
        """Time of step i."""
        return self.start_ns + i * self.period_ns


def common_timeline(
    times_ns: Mapping[str, Array],
    rate_hz: float | None,
    start_s: float | None,
    end_s: float | None,
) -> Timeline:
    """Time steps at the fastest camera's rate (or `rate_hz`), in phase with it, over all that any camera recorded.

    Raises:
        SourceError: nothing recorded between start_s and end_s, or more time steps than a recording can have.
    """
    starts, ends = [t[0] for t in times_ns.values()], [t[-1] for t in times_ns.values()]
    periods = {name: period_ns for name, t in times_ns.items() if (period_ns := frame_period_ns(t)) is not None}
    # of cameras that are equally fast but for the rounding of their times, the first
    fastest = min(periods, key=lambda name: round(periods[name], -3), default=next(iter(times_ns)))
    period_ns = round(1e9 / rate_hz) if rate_hz else round(periods.get(fastest, 1e9 / 30))
    first_ns = int(times_ns[fastest][0])
    first_ns -= (first_ns - int(min(starts)) + period_ns // 2) // period_ns * period_ns
    last_ns = int(max(ends))
    if start_s is not None:
        first_ns += max(0, -(-(round(start_s * 1e9) - first_ns) // period_ns)) * period_ns
    if end_s is not None:
        last_ns = min(last_ns, round(end_s * 1e9))
    count = (last_ns + period_ns // 2 - first_ns) // period_ns + 1
    if count < 1:
        raise SourceError(
            f"nothing recorded from {start_s} to {end_s} s; the recording runs from {min(starts) / 1e9:.3f} to "
            f"{max(ends) / 1e9:.3f} s"
        )
    check_time_steps(int(count), 1e9 / period_ns, "the recording")
    return Timeline(first_ns, period_ns, int(count))


def frame_period_ns(t_ns: Array) -> float | None:
    """The time from frame to frame of a camera, over all its time; None for fewer than two frames.

    Files round times (Matroska to milliseconds), so the median of the differences is off; frames that are missing are counted.
    """
    t_ns = np.unique(t_ns)
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


def check_time_steps(count: int, rate_hz: float, what: str) -> None:
    """Raise SourceError for more time steps than a recording can have, as a damaged time or a wrong rate makes them."""
    if count > _MOST_TIME_STEPS:
        raise SourceError(
            f"{what}: {count:.4g} time steps ({count / rate_hz:.4g} s at {rate_hz:.4g} Hz); expected at most {_MOST_TIME_STEPS}: "
            "check rate_hz and the times of the cameras, or choose a part with `start_s=S` and `end_s=S`"
        )


@dataclass(frozen=True, eq=False)
class ImageStep:
    """One time step of decoded images; implements `TimeStep`.

    Attributes:
        t_ns: session clock. frames: axis C; None where a camera has none. rig, detector: what looks at them.
    """

    t_ns: int
    frames: Sequence[Frame | None]
    rig: Rig
    detector: Detector

    def look(self, kind: LookKind, expected: Pose3D | None) -> tuple[Detections2D, ...]:
        """What the detector finds now, in whole images or where people are expected."""
        present = [(c, frame) for c, frame in enumerate(self.frames) if frame is not None]
        regions = [None if expected is None else self._regions(c, expected) for c, _ in present]
        found = self.detector.detect([frame for _, frame in present], regions)
        frames = [frame for _, frame in present]
        return tuple(with_depth(with_clothing(one, frame.image), frame.depth) for one, frame in zip(found, frames, strict=True))

    def _regions(self, c: int, pose: Pose3D) -> list[Region]:
        made = [region_from_pose(self.rig.cameras[c], xyz, pose.skeleton) for xyz in pose.xyz_world]
        return [region for region in made if region is not None]


class ImageTimeSteps:
    """Time steps of videos or image folders: decodes ahead and runs the detector on demand."""

    def __init__(
        self,
        rig: Rig,
        sources: Sequence[RecordedSource],
        detector: Detector,
        timeline: Timeline,
        on_lost: Callable[[str, SourceError], None],
    ) -> None:
        self._rig, self._detector, self._timeline, self._on_lost = rig, detector, timeline, on_lost
        self._sources = sources
        self._counted: list[CountedSource] = []
        self._streams: list[FramesAhead] = []

    @property
    def skeleton(self) -> Skeleton:
        """The detector's keypoints."""
        return self._detector.skeleton

    @property
    def joint_centres(self) -> JointCentres | None:
        """Where joint centres lie relative to the detector's keypoints, where that is known."""
        return self._detector.joint_centres

    def steps(self, stored: Observations | None = None) -> Iterator[ImageStep]:
        """The time steps after those of `stored`; may be called once."""
        line, first = self._timeline, 0 if stored is None else len(stored.step_t_ns)
        self._counted = [self._from(source, first, stored) for source in self._sources]
        self._streams = [FramesAhead(source) for source in self._counted]
        streams = {source.camera: stream for source, stream in zip(self._counted, self._streams, strict=True)}
        sets = frame_sets(streams, line.t_ns(first), line.period_ns, line.t_ns(line.count - 1), on_lost=self._on_lost)
        for frame_set in sets:
            yield ImageStep(frame_set.t_ns, frame_set.frames, self._rig, self._detector)

    def close(self) -> None:
        """Stop decoding."""
        for stream in self._streams:
            stream.close()
        for source in self._sources:
            source.close()

    def incomplete(self) -> list[str]:
        """One line for each camera of which part cannot be read, or that ends before the others."""
        line = self._timeline
        end_ns = line.start_ns + (line.count - 1) * line.period_ns
        return incomplete_cameras([source.coverage(line.start_ns, end_ns) for source in self._counted])

    def _from(self, source: RecordedSource, first: int, stored: Observations | None) -> CountedSource:
        """The source from the frames of time step `first` on, where it is known of all frames before whether they can be read."""
        line = self._timeline
        begin_ns = line.t_ns(first) - line.period_ns
        if stored is None:
            return CountedSource(source, begin_ns)
        listed = source.times_ns()
        earlier = listed[(listed >= line.start_ns) & (listed < begin_ns)]
        seen = stored.frame_t_ns[stored.frame_camera == stored.camera_names.index(source.camera)]
        if np.isin(earlier, seen).all():
            return CountedSource(source, begin_ns, earlier.tolist())
        return CountedSource(source, line.start_ns - line.period_ns)
