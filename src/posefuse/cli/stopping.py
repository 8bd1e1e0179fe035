"""Requests to end the program, as exceptions; imports nothing heavy, because it is needed before anything is imported."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from posefuse.foundation.requests_to_end import HANG_UP, REQUESTS_TO_END, Repeats, handling, heeded, put_off, without_terminal

FAILED_CODE = 1
INTERRUPTED_CODE = 130
# a live session in which no person was ever tracked
NO_PERSON_CODE = 3
# a program that a signal ends has this code plus the number of the signal
_SIGNAL_CODE = 128


class Terminated(KeyboardInterrupt):
    """The system asks the program to end (SIGTERM, SIGHUP): whatever handles Ctrl-C handles this in the same way."""


class StopRequests:
    """Which request came, also where a command dealt with it and ended in an orderly way."""

    def __init__(self) -> None:
        self._pid = os.getpid()
        self._request: signal.Signals | None = None
        self._repeats = Repeats()

    @property
    def exit_code(self) -> int:
        """The exit code of a program that was stopped."""
        return INTERRUPTED_CODE if self._request is None else _SIGNAL_CODE + self._request

    @property
    def cause(self) -> str:
        """What stopped the program, in words."""
        return "Ctrl-C" if self._request is None else self._request.name

    def end(self, number: int, frame: FrameType | None) -> None:
        """Handler of requests to end; raises Terminated, after Ctrl-C KeyboardInterrupt."""
        if os.getpid() != self._pid:
            # a forked child has the handler too, and only wants to end
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
            return
        if put_off(number, frame):
            return
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        if self._repeats.repeated(number):
            return
        self._request = signal.Signals(number)
        if number == HANG_UP:
            without_terminal()
        raise Terminated


def session_exit_code(stopped_by: str, *, endless: bool, failed: bool) -> int:
    """The exit code of a live session: Ctrl-C is how one without a duration is meant to end, and cuts any other short.

    Args:
        stopped_by: name of the signal that ended it, empty where none did. endless: no duration was asked for.
        failed: something failed on the way; that outweighs how it ended.
    """
    if failed:
        return FAILED_CODE
    if stopped_by and signal.Signals[stopped_by] in REQUESTS_TO_END:
        return _SIGNAL_CODE + signal.Signals[stopped_by]
    return INTERRUPTED_CODE if stopped_by and not endless else 0


@contextmanager
def terminate_on_signals() -> Iterator[StopRequests]:
    """SIGTERM and SIGHUP raise Terminated in the block, Ctrl-C KeyboardInterrupt, all three only where that can be raised.

    Outside the main thread, where no handler can be set, nothing changes.
    """
    requests = StopRequests()
    if threading.current_thread() is not threading.main_thread():
        yield requests
        return
    with handling(heeded((signal.SIGINT, *REQUESTS_TO_END)), requests.end):
        yield requests
