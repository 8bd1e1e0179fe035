"""Frames of several cameras that belong to the same time step, and their decoding ahead of its use."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from posefuse.core import Frame, PosefuseError, Source, SourceError
from posefuse.foundation.platform import lower_thread_priority

# frames are decoded well ahead of their use: what uses them now does not wait for them
_NICENESS = 5
_END = object()


@dataclass(frozen=True, eq=False)
class FrameSet:
    """At most one frame per camera, each the nearest to one time step.

    Attributes:
        t_ns: the time step, session clock.
        frames: axis C; None where a camera has no frame within half a period.
    """

    t_ns: int
    frames: tuple[Frame | None, ...]


def frame_sets(
    streams: Mapping[str, Iterable[Frame]],
    start_ns: int,
    period_ns: int,
    end_ns: int | None = None,
    on_lost: Callable[[str, SourceError], None] | None = None,
) -> Iterator[FrameSet]:
    """Frame sets every `period_ns` from `start_ns` on, until all cameras have ended or `end_ns` is reached.

    Cameras may begin and end at different times, drop frames or run at other rates: each gives to a time step the frame
    nearest to it, if that is within half a period, and no frame twice. A camera that fails is reported to `on_lost` and
    continues as one that has ended; without `on_lost` its error is raised.
    """
    cursors = [_Cursor(name, iter(frames), on_lost) for name, frames in streams.items()]
    tick = 0
    while any(not cursor.ended for cursor in cursors):
        t_ns = start_ns + tick * period_ns
        if end_ns is not None and t_ns > end_ns:
            return
        frames = tuple(cursor.nearest(t_ns, period_ns // 2) for cursor in cursors)
        if any(frame is not None for frame in frames) or any(not cursor.ended for cursor in cursors):
            yield FrameSet(t_ns, frames)
        tick += 1


class _Cursor:
    """Walks one camera's frames forward."""

    def __init__(self, name: str, frames: Iterator[Frame], on_lost: Callable[[str, SourceError], None] | None) -> None:
        self._name = name
        self._frames = frames
        self._on_lost = on_lost
        self._next: Frame | None = None
        self.ended = False
        self._advance()

    def nearest(self, t_ns: int, reach_ns: int) -> Frame | None:
        """The frame nearest to t_ns within (t - reach, t + reach]; later frames stay for later time steps."""
        best: Frame | None = None
        while self._next is not None and self._next.t_ns <= t_ns + reach_ns:
            candidate = self._next
            if candidate.t_ns > t_ns - reach_ns and (best is None or abs(candidate.t_ns - t_ns) <= abs(best.t_ns - t_ns)):
                best = candidate
            self._advance()
        return best

    def _advance(self) -> None:
        try:
            self._next = next(self._frames, None)
        except SourceError as error:
            self._next = None
            if self._on_lost is None:
                raise
            self._on_lost(self._name, error)
        self.ended = self._next is None


class FramesAhead:
    """Iterates over a source's frames while a thread already decodes the next ones.

    An error of the source is raised where its frame would have come. Closing stops the thread at once.
    """

    def __init__(self, source: Source, depth: int = 8) -> None:
        self._source = source
        self._queue: queue.Queue[Any] = queue.Queue(maxsize=depth)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._fill, name=f"decode {source.camera}", daemon=True)
        try:
            self._thread.start()
        except BaseException:
            # Ctrl-C while it waits for the thread, which no one could close any more
            self._stop.set()
            raise

    def __iter__(self) -> Iterator[Frame]:
        while not self._stop.is_set():
            item = self._queue.get()
            if item is _END:
                return
            if isinstance(item, BaseException):
                raise item
            yield item

    def close(self) -> None:
        """Stop decoding and release the source."""
        self._stop.set()
        while self._thread.is_alive():
            self._drain()
            self._thread.join(timeout=0.05)
        self._source.close()

    def _drain(self) -> None:
        with suppress(queue.Empty):
            while True:
                self._queue.get_nowait()

    def _fill(self) -> None:
        lower_thread_priority(_NICENESS)
        try:
            for frame in self._source.frames():
                if not self._put(frame.converted()):
                    return
            self._put(_END)
        except PosefuseError as error:
            self._put(error)
        except (OSError, MemoryError, RuntimeError) as error:
            self._put(SourceError(f"camera {self._source.camera}: stopped delivering ({error})"))

    def _put(self, item: object) -> bool:
        while not self._stop.is_set():
            try:
                self._queue.put(item, timeout=0.1)
                return True
            except queue.Full:
                continue
        return False
