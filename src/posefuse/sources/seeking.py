"""Any frame of a recording at once: for players, which jump about in a video instead of reading it from the start."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Lock

import numpy as np

from posefuse.core import Closing, Frame, SourceError
from posefuse.core.arrays import Array
from posefuse.core.view_sequences import nearest_frames

from .coverage import RecordedSource

# a jump costs at least as much as so many frames
_READ_ON = 8


def nearest(times_ns: Array, t_ns: int) -> int:
    """The place of the frame nearest in time."""
    return int(nearest_frames(times_ns, np.array(t_ns)))


class Seeker(Closing):
    """The frames of one camera, in any order; may be asked from several threads. Reading on decodes each frame once.

    Attributes:
        times_ns: (F,) session times of all frames that the source lists, increasing.

    Raises:
        SourceError: it lists no frame.
    """

    def __init__(self, source: RecordedSource) -> None:
        self._source, self._lock = source, Lock()
        self.times_ns = source.times_ns()
        if not len(self.times_ns):
            raise SourceError(f"camera {source.camera}: no frame is listed; is the file complete?")
        self._frames: Iterator[Frame] = iter(())
        self._last: Frame | None = None
        self._place = -_READ_ON - 1

    def at(self, i: int) -> Frame:
        """Frame i, or the first after it that can be decoded; raises SourceError where there is none."""
        t_ns = int(self.times_ns[i])
        with self._lock:
            if not self._place <= i <= self._place + _READ_ON:
                self._frames, self._last = self._source.frames_from(t_ns), None
            self._place = i
            if self._last is None or self._last.t_ns < t_ns:
                self._last = next((frame for frame in self._frames if frame.t_ns >= t_ns), None)
            if self._last is None:
                raise SourceError(f"camera {self._source.camera}: no frame from {t_ns / 1e9:.3f} s on can be decoded")
            return self._last

    def close(self) -> None:
        """Release the file."""
        with self._lock:
            self._frames = iter(())
            self._source.close()
