"""Time steps of a recording: when they are, and what the detector answers in each, now or as a log has it."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from posefuse.core import Detections2D, Detector, Frame, LookKind, Observations, Pose3D, Region, Rig, Source, SourceError
from posefuse.core.arrays import Array
from posefuse.detection import region_from_pose, with_clothing, with_depth
from posefuse.sources import CountedSource, FramesAhead, FrameSet, RecordedSource, frame_sets, incomplete_cameras

OnLost = Callable[[str, SourceError], None]
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

    @property
    def span_ns(self) -> tuple[int, int]:
        """Time of the first step and of the last one."""
        return self.start_ns, self.t_ns(self.count - 1)


def common_timeline(
    times_ns: Mapping[str, Array],
    rate_hz: float | None,
    start_s: float | None,
    end_s: float | None,
) -> Timeline:
    """Time steps at the fastest camera's rate (or `rate_hz`), in phase with it, over all that any camera recorded.

    The first is the one nearest to `start_s`, the last the one nearest to `end_s`.

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
        first_ns += max(0, -(-(round(start_s * 1e9) - period_ns // 2 - first_ns) // period_ns)) * period_ns
    if end_s is not None:
        last_ns = min(last_ns, round(end_s * 1e9))
    count = (last_ns + period_ns // 2 - first_ns) // period_ns + 1
    if count < 1:
        begin, end = "" if start_s is None else f" from {start_s:g} s", "" if end_s is None else f" until {end_s:g} s"
        raise SourceError(
            f"nothing recorded{begin}{end}; the recording runs from {min(starts) / 1e9:.3f} to {max(ends) / 1e9:.3f} s"
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


class TimeStep(Protocol):
    """One time step of a recording."""

    @property
    def t_ns(self) -> int:
        """Session clock."""
        ...

    def look(self, kind: LookKind, expected: Pose3D | None) -> tuple[Detections2D, ...]:
        """What the detector finds in each camera that has a frame, each at its own exposure time, in the order of the rig.

        `expected`: the people to look for; None (in a search): everywhere.
        """
        ...


@dataclass(frozen=True)
class StoredStep:
    """A time step whose detections are known already: the answers come from the log.

    Attributes:
        observations: the log. step: which of its time steps.
        frames: rows of its frame table for this time step.
    """

    observations: Observations
    step: int
    frames: Array

    @property
    def t_ns(self) -> int:
        """Session clock."""
        return int(self.observations.step_t_ns[self.step])

    def look(self, kind: LookKind, expected: Pose3D | None) -> tuple[Detections2D, ...]:
        """The stored answer to this look; where the detector did not look so, all detections of each frame.

        One body may be among these several times, as the answers of several looks: association takes it once.
        """
        return tuple(self.observations.detections(frame, rows) for frame, rows in self.rows(kind))

    def rows(self, kind: LookKind) -> list[tuple[int, Array]]:
        """Where the answers of `look` lie in the log: (row of the frame table, rows of the detection table) of each."""
        log, kinds = self.observations, self.observations.frame_look[self.frames]
        answers = self.frames[(kinds == kind) | (kinds == LookKind.STATED)]
        rows = {int(i): np.arange(log.frame_begin[i], log.frame_begin[i + 1]) for i in self.frames}
        if len(answers):
            return [(i, rows[i]) for i in answers.tolist()]
        cameras = log.frame_camera[self.frames]
        by_camera = [self.frames[cameras == camera].tolist() for camera in np.unique(cameras)]
        return [(frames[0], np.concatenate([rows[i] for i in frames])) for frames in by_camera]


def stored_steps(observations: Observations, first: int = 0) -> Iterator[StoredStep]:
    """The time steps of a log, in order, from the one of this number on."""
    order = np.argsort(observations.frame_step, kind="stable")
    begin = np.searchsorted(observations.frame_step[order], np.arange(len(observations.step_t_ns) + 1))
    for step in range(first, len(observations.step_t_ns)):
        yield StoredStep(observations, step, order[begin[step] : begin[step + 1]])


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


def decoded(
    sources: Iterable[Source], start_ns: int, period_ns: int, end_ns: int, on_lost: OnLost | None = None
) -> Generator[FrameSet]:
    """The frames of several cameras at even time steps, decoded ahead until it is closed.

    Args:
        on_lost: called for a camera that breaks off; None: its SourceError is raised.
    """
    streams: dict[str, FramesAhead] = {}
    try:
        for source in sources:
            streams[source.camera] = FramesAhead(source)
        yield from frame_sets(streams, start_ns, period_ns, end_ns, on_lost=on_lost)
    finally:
        for stream in streams.values():
            stream.close()


class ImageTimeSteps:
    """Time steps of videos or image folders: decodes ahead and runs the detector on demand."""

    def __init__(
        self,
        rig: Rig,
        sources: Sequence[RecordedSource],
        detector: Detector,
        timeline: Timeline,
        on_lost: OnLost | None = None,
    ) -> None:
        self._rig, self._timeline, self._on_lost = rig, timeline, on_lost
        self._detector: Detector | None = detector
        self._sources = sources
        self._counted: list[CountedSource] = []
        self._sets: Generator[FrameSet] | None = None

    def steps(self, stored: Observations | None = None) -> Iterator[ImageStep]:
        """The time steps after those of `stored`; may be called once."""
        line, first, detector = self._timeline, 0 if stored is None else len(stored.step_t_ns), self._detector
        assert detector is not None  # time steps are read before closing
        self._counted = [self._from(source, first, stored) for source in self._sources]
        self._sets = decoded(self._counted, line.t_ns(first), line.period_ns, line.span_ns[1], self._on_lost)
        for frame_set in self._sets:
            yield ImageStep(frame_set.t_ns, frame_set.frames, self._rig, detector)

    def close(self) -> None:
        """Stop decoding, and let the detector go: its network takes as much memory as some minutes of results."""
        if self._sets is not None:
            self._sets.close()
        for source in self._sources:
            source.close()
        self._detector = self._sets = None

    def incomplete(self) -> list[str]:
        """One line for each camera of which part cannot be read, or that ends before the others."""
        return incomplete_cameras([source.coverage(*self._timeline.span_ns) for source in self._counted])

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
