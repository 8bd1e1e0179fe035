"""Recorded sources: how much of each could be read (a damaged or short one is named, with its share), and depth images added."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from posefuse.core import Frame, InputError, Source, SourceError
from posefuse.core.arrays import Array
from posefuse.formats.image_folders import DepthFolder

# containers list a frame or two that players never show; an end that differs by so little is how cameras are stopped
_FRAMES_THAT_DO_NOT_MATTER = 3
_SHARE_THAT_DOES_NOT_MATTER = 0.01


@dataclass(frozen=True)
class Coverage:
    """What was read of one camera between two session times.

    Attributes:
        expected: frames its file or folder lists or states. read: of these, how many were delivered.
        end_ns: time of the last one delivered; None where none was. period_ns: between its frames.
    """

    camera: str
    expected: int
    read: int
    end_ns: int | None
    period_ns: int

    @property
    def missing(self) -> int:
        """Frames that were expected and not delivered."""
        return max(0, self.expected - self.read)


class RecordedSource(Source, Protocol):
    """A source that knows beforehand what it should deliver."""

    def times_ns(self) -> Array:
        """(F,) int64 session times of the frames it lists."""
        ...

    def frames_from(self, begin_ns: int) -> Iterator[Frame]:
        """Those of `frames` that are not before a session time, without the time that it takes to decode all before it."""
        ...

    @property
    def stated_frames(self) -> int:
        """The number of frames that its header states; 0 where it states none."""
        ...


class _SourceOf:
    """A source that changes the frames of another one; all else is that one's."""

    def __init__(self, source: RecordedSource) -> None:
        self._source = source
        self.camera, self.size_wh, self.stated_frames = source.camera, source.size_wh, source.stated_frames

    def times_ns(self) -> Array:
        """Those of the source."""
        return self._source.times_ns()

    def close(self) -> None:
        """Close the source."""
        self._source.close()


class CountedSource(_SourceOf):
    """A source from a time on, that remembers what it delivered.

    Args:
        begin_ns: frames before it are left out. earlier_ns: of these, times of those that were delivered already.
    """

    def __init__(self, source: RecordedSource, begin_ns: int, earlier_ns: Sequence[int] = ()) -> None:
        super().__init__(source)
        self._begin_ns, self._earlier_ns = begin_ns, earlier_ns
        self._delivered_ns: list[int] = []

    def frames(self) -> Iterator[Frame]:
        """Frames in time order from the time on, counted again."""
        self._delivered_ns = [*self._earlier_ns]
        for frame in self._source.frames_from(self._begin_ns):
            self._delivered_ns.append(frame.t_ns)
            yield frame

    def coverage(self, start_ns: int, end_ns: int) -> Coverage:
        """What the last call of `frames` delivered from `start_ns` to `end_ns`."""
        listed = self._source.times_ns()
        period_ns = int(np.median(np.diff(listed))) if len(listed) > 1 else 0
        cut_off = max(0, self._source.stated_frames - len(listed))
        if cut_off and period_ns:
            # frames that the file states and no longer holds would have come at its end
            cut_off = min(cut_off, max(0, (end_ns - int(listed[-1])) // period_ns))
        read = [t for t in self._delivered_ns if start_ns <= t <= end_ns]
        expected = int(((listed >= start_ns) & (listed <= end_ns)).sum()) + cut_off
        return Coverage(self.camera, expected, len(read), read[-1] if read else None, period_ns)


def incomplete_cameras(coverages: Sequence[Coverage]) -> list[str]:
    """One line for each camera of which part cannot be read, or that ends before the others; `coverages`: one per camera."""
    last_ns = max((one.end_ns for one in coverages if one.end_ns is not None), default=0)
    return [line for one in coverages if (line := _line(one, last_ns))]


def _line(one: Coverage, last_ns: int) -> str | None:
    if one.end_ns is None:
        return f"camera {one.camera}: none of its {one.expected} frames can be read" if one.expected else None
    early_ns = last_ns - one.end_ns
    frames_ns = one.period_ns * max(one.read, 1)
    matters = max(_FRAMES_THAT_DO_NOT_MATTER * one.period_ns, _SHARE_THAT_DOES_NOT_MATTER * frames_ns)
    stops = f"it stops at {one.end_ns / 1e9:.2f} s, the recording at {last_ns / 1e9:.2f} s" if early_ns > matters else ""
    if one.missing > max(_FRAMES_THAT_DO_NOT_MATTER - 1, _SHARE_THAT_DOES_NOT_MATTER * one.expected):
        share = one.missing / one.expected
        line = f"camera {one.camera}: {share:.0%} of its frames cannot be read ({one.missing} of {one.expected})"
        return f"{line}; {stops}" if stops else line
    return f"camera {one.camera}: {stops}" if stops else None


class DepthSource(_SourceOf):
    """The same frames with depth, where the folder has an image of that time; implements `RecordedSource`.

    Args:
        source: videos or images. folder: see `formats.image_folders`.
        offset_s, drift_ppm: those of the source, which the names of the depth images do not contain.

    Raises:
        SourceError: the folder holds something else, or images of other times.
    """

    def __init__(self, source: RecordedSource, folder: Path, offset_s: float = 0.0, drift_ppm: float = 0.0) -> None:
        super().__init__(source)
        self._offset_ns, self._stretch = offset_s * 1e9, 1 + drift_ppm * 1e-6
        try:
            self._depth = DepthFolder(folder)
            self._depth.check_times([self._own_ns(t_ns) for t_ns in source.times_ns().tolist()])
        except (InputError, OSError) as error:
            raise SourceError(f"{folder}: camera {source.camera}: {error}") from None

    def frames(self) -> Iterator[Frame]:
        """The source's frames; raises SourceError for a depth image that cannot be read."""
        return self._with_depth(self._source.frames())

    def frames_from(self, begin_ns: int) -> Iterator[Frame]:
        """See `RecordedSource`."""
        return self._with_depth(self._source.frames_from(begin_ns))

    def _with_depth(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        for frame in frames:
            try:
                depth = self._depth.at(self._own_ns(frame.t_ns), frame.size_wh)
            except InputError as error:
                raise SourceError(f"camera {self.camera}: {error}") from None
            yield replace(frame, depth=depth)

    def _own_ns(self, t_ns: int) -> int:
        """Time in the file of a frame at a time of the session."""
        return round((t_ns - self._offset_ns) / self._stretch)
