"""Time steps of videos and image folders: decoded ahead, detected when asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.core import Detections2D, Detector, Frame, JointCentres, LookKind, Pose3D, Region, Rig, Skeleton, SourceError
from posefuse.core.arrays import Array
from posefuse.detection import region_from_pose, with_clothing, with_depth
from posefuse.sources import CountedSource, FramesAhead, RecordedSource, frame_sets, incomplete_cameras
from posefuse.tracking import joint_centres_of

from .config import TrackConfig


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
    *,
    max_time_steps: int = TrackConfig().max_time_steps,
) -> Timeline:
    """Time steps at the fastest camera's rate (or `rate_hz`), in phase with it, over all that any camera recorded.

    Raises:
        SourceError: nothing recorded between start_s and end_s, or more than max_time_steps.
    """
    starts, ends = [t[0] for t in times_ns.values()], [t[-1] for t in times_ns.values()]
    periods = {name: float(np.median(np.diff(t))) for name, t in times_ns.items() if len(t) > 1}
    fastest = min(periods, key=lambda name: periods[name], default=next(iter(times_ns)))
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
    check_time_steps(int(count), 1e9 / period_ns, "the recording", max_time_steps)
    return Timeline(first_ns, period_ns, int(count))


def check_time_steps(count: int, rate_hz: float, what: str, max_time_steps: int) -> None:
    """Raise SourceError for more time steps than a recording can have, as a damaged time or a wrong rate makes them."""
    if count > max_time_steps:
        raise SourceError(
            f"{what}: {count:.4g} time steps ({count / rate_hz:.4g} s at {rate_hz:.4g} Hz); expected at most {max_time_steps}: "
            "check rate_hz and the times of the cameras, choose a part with `start_s=S` and `end_s=S`, or set max_time_steps"
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


class ImageInstants:
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
        self._sources = [CountedSource(source) for source in sources]
        self._streams = {source.camera: FramesAhead(source) for source in self._sources}

    @property
    def skeleton(self) -> Skeleton:
        """The detector's keypoints."""
        return self._detector.skeleton

    @property
    def joint_centres(self) -> JointCentres | None:
        """Where joint centres lie relative to the detector's keypoints, where that is known."""
        return joint_centres_of(self._detector, proportions=False)

    def steps(self, first: int = 0) -> Iterator[ImageStep]:
        """The time steps from number `first` on; may be called once."""
        line = self._timeline
        sets = frame_sets(
            self._streams, line.t_ns(first), line.period_ns, line.t_ns(line.count - 1), on_lost=self._on_lost
        )  # fmt: skip
        for frame_set in sets:
            yield ImageStep(frame_set.t_ns, frame_set.frames, self._rig, self._detector)

    def close(self) -> None:
        """Stop decoding."""
        for stream in self._streams.values():
            stream.close()

    def incomplete(self) -> list[str]:
        """One line for each camera of which part cannot be read, or that ends before the others."""
        line = self._timeline
        end_ns = line.start_ns + (line.count - 1) * line.period_ns
        return incomplete_cameras([source.coverage(line.start_ns, end_ns) for source in self._sources])
