"""What all cameras saw at one instant, looked at when asked for: from images by a 2D estimator, or from files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.core import Detections2D, Detector, Frame, Pose3D, Rig, Skeleton, Source, SourceError
from posefuse.core.arrays import Array
from posefuse.detection import region_from_pose
from posefuse.detection.build import joint_centres_of
from posefuse.sources import FramesAhead, frame_sets
from posefuse.tracking import JointCentres

Look = Callable[[Pose3D | None], list[Detections2D]]


@dataclass(frozen=True, eq=False)
class Instant:
    """One instant of a recording.

    Attributes:
        t_ns: session clock.
        look: (pose of the tracked people, or None: find them) -> one Detections2D per camera of the rig, in its order.
    """

    t_ns: int
    look: Look


@dataclass(frozen=True)
class Timeline:
    """Evenly spaced instants: start_ns + i * period_ns for i < count."""

    start_ns: int
    period_ns: int
    count: int


def common_timeline(times_ns: Mapping[str, Array], rate_hz: float | None, start_s: float | None, end_s: float | None) -> Timeline:
    """Instants at the fastest camera's rate (or `rate_hz`), in phase with it, over all that any camera recorded.

    Raises:
        SourceError: nothing recorded between start_s and end_s.
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
    return Timeline(first_ns, period_ns, int(count))


class ImageInstants:
    """Instants of videos or image folders: decodes ahead and runs the 2D estimator on demand."""

    def __init__(
        self,
        rig: Rig,
        sources: Sequence[Source],
        detector: Detector,
        timeline: Timeline,
        on_lost: Callable[[str, SourceError], None],
    ) -> None:
        self._rig, self._detector, self._timeline, self._on_lost = rig, detector, timeline, on_lost
        self._streams = {source.camera: FramesAhead(source) for source in sources}

    @property
    def skeleton(self) -> Skeleton:
        """The 2D estimator's keypoints."""
        return self._detector.skeleton

    @property
    def joint_centres(self) -> JointCentres | None:
        """How joint centres lie beside the 2D estimator's keypoints, where it knows."""
        return joint_centres_of(self._detector)

    def __iter__(self) -> Iterator[Instant]:
        line = self._timeline
        sets = frame_sets(
            self._streams,
            line.start_ns,
            line.period_ns,
            line.start_ns + (line.count - 1) * line.period_ns,
            on_lost=self._on_lost,
        )
        for frame_set in sets:
            yield Instant(frame_set.t_ns, lambda pose, frames=frame_set.frames: self._look(frames, pose))  # type: ignore[misc]

    def close(self) -> None:
        """Stop decoding."""
        for stream in self._streams.values():
            stream.close()

    def _look(self, frames: Sequence[Frame | None], pose: Pose3D | None) -> list[Detections2D]:
        present = [(c, frame) for c, frame in enumerate(frames) if frame is not None]
        regions = [None if pose is None else self._regions(c, pose) for c, _ in present]
        found = iter(self._detector.detect([frame for _, frame in present], regions))
        seen = {c: next(found) for c, _ in present}
        return [seen.get(c) or Detections2D.nobody(name, 0, self._detector.skeleton) for c, name in enumerate(self._rig.names)]

    def _regions(self, c: int, pose: Pose3D) -> list[object] | None:
        made = [region_from_pose(self._rig.cameras[c], xyz, pose.skeleton) for xyz in pose.xyz_world]
        return [region for region in made if region is not None]
