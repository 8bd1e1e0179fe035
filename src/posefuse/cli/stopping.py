"""Requests to end the program, as exceptions; imports nothing heavy, because it is needed before anything is imported."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

FAILED_CODE = 1
INTERRUPTED_CODE = 130
TERMINATED_CODE = 143


class Terminated(KeyboardInterrupt):
    """The system asks the program to end (SIGTERM): whatever handles Ctrl-C handles this in the same way."""


class StopRequests:
    """Which request came, also where a command dealt with it and ended in an orderly way."""

    def __init__(self) -> None:
        self._pid = os.getpid()
        self._terminated = False

    @property
    def exit_code(self) -> int:
        """The exit code of a program that was stopped."""
        return TERMINATED_CODE if self._terminated else INTERRUPTED_CODE

    @property
    def cause(self) -> str:
        """What stopped the program, in words."""
        return "SIGTERM" if self._terminated else "Ctrl-C"

    def terminate(self, number: int, frame: FrameType | None) -> None:
        """Handler of SIGTERM; raises Terminated."""
        if os.getpid() != self._pid:
            # a forked child has the handler too, and only wants to end
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        self._terminated = True
        raise Terminated


def session_exit_code(stopped_by: str, *, endless: bool, failed: bool) -> int:
    """The exit code of a live session: Ctrl-C is how one without a duration is meant to end, and cuts any other short.

    Args:
        stopped_by: name of the signal that ended it, empty where none did. endless: no duration was asked for.
        failed: something failed on the way; that outweighs how it ended.
    """
    if failed:
        return FAILED_CODE
    if stopped_by == signal.Signals.SIGTERM.name:
        return TERMINATED_CODE
    return INTERRUPTED_CODE if stopped_by and not endless else 0


@contextmanager
def stop_requests() -> Iterator[StopRequests]:
    """SIGTERM raises Terminated in the block; outside the main thread, where no handler can be set, nothing changes."""
    requests = StopRequests()
    if threading.current_thread() is not threading.main_thread():
        yield requests
        return
    before = signal.signal(signal.SIGTERM, requests.terminate)
    try:
        yield requests
    finally:
        signal.signal(signal.SIGTERM, before)
