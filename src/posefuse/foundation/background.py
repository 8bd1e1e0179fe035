"""Work that continues in a thread of its own while the caller prepares the next piece."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

_WAITING = 3


class Background:
    """Calls a function in one other thread, in the order of the calls, a few of which may wait.

    What the function raises is raised by a later `call`, or by `close`.
    """

    def __init__(self, function: Callable[..., object], name: str) -> None:
        self._function = function
        self._pool = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._pending: deque[Future[object]] = deque()

    def call(self, *args: Any) -> None:
        """Do it later; waits while too many wait already."""
        while len(self._pending) >= _WAITING:
            self._pending.popleft().result()
        self._pending.append(self._pool.submit(self._function, *args))

    def close(self) -> None:
        """Wait until all is done; safe to call twice. After an error, calls that have not begun are left out."""
        try:
            while self._pending:
                self._pending.popleft().result()
        finally:
            for future in self._pending:
                future.cancel()
            self._pending.clear()
            self._pool.shutdown()
