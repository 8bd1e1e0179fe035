"""Decoding ahead of its use, in one thread per camera, never more than a few frames."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from typing import Any

from posefuse.core import Frame, PosefuseError, Source, SourceError
from posefuse.foundation.platform import lower_thread_priority

# frames are decoded well ahead of their use: what uses them now does not wait for them
_NICENESS = 5
_END = object()


class FramesAhead:
    """Iterates over a source's frames while a thread already decodes the next ones.

    An error of the source is raised where its frame would have come. Closing stops the thread at once.
    """

    def __init__(self, source: Source, depth: int = 8) -> None:
        self._source = source
        self._queue: queue.Queue[Any] = queue.Queue(maxsize=depth)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._fill, name=f"decode {source.camera}", daemon=True)
        self._thread.start()

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
        try:
            while True:
                self._queue.get_nowait()
        except queue.Empty:
            pass

    def _fill(self) -> None:
        lower_thread_priority(_NICENESS)
        try:
            for frame in self._source.frames():
                if not self._put(frame):
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
