"""Lines for a reader that may have stopped: the session never waits for it."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from .news import Say

_MOST_LINES = 1000
_END_S = 2.0


@contextmanager
def never_waiting(say: Say) -> Iterator[Say]:
    """Call `say` in a thread of its own; what there is no room for is lost. What it raises, the next call raises.

    At the end the lines that are left are given a moment.
    """
    lines: queue.Queue[str | None] = queue.Queue(_MOST_LINES)
    problems: list[Exception] = []

    def run() -> None:
        while (line := lines.get()) is not None:
            try:
                say(line)
            except Exception as error:  # noqa: BLE001 - a closed terminal or connection; raised where the session notices it
                problems.append(error)
                return

    def put(line: str) -> None:
        if problems:
            raise problems[0]
        with suppress(queue.Full):
            lines.put_nowait(line)

    thread = threading.Thread(target=run, name="news", daemon=True)
    thread.start()
    try:
        yield put
    finally:
        with suppress(queue.Full):
            lines.put_nowait(None)
            thread.join(_END_S)
