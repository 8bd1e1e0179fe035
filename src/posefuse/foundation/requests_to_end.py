"""Signals that ask a program to end, and how its child processes take them; imports nothing heavy."""

from __future__ import annotations

import _thread
import math
import os
import signal
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import Any

HANG_UP: signal.Signals | None = getattr(signal, "SIGHUP", None)
"""The terminal was closed, or the connection to it was lost; None where the system has no such signal."""
REQUESTS_TO_END: tuple[signal.Signals, ...] = (signal.SIGTERM, *([] if HANG_UP is None else [HANG_UP]))
# `timeout` and others send one request to the program and to its group: it arrives twice
_REPEATED_S = 0.5
# modules from which C code calls back
_UNINTERRUPTED = ("llvmlite", "weakref", "_weakrefset")
_AGAIN_S = 0.02
# longer than a session takes to end its processes in order
_GRACE_S = 120.0


class Repeats:
    """Recognizes a request that arrives once more."""

    def __init__(self) -> None:
        self._last_s: dict[int, float] = {}

    def repeated(self, number: int) -> bool:
        """Whether this signal came within the last half second, too."""
        now_s = time.monotonic()
        before_s, self._last_s[number] = self._last_s.get(number, -math.inf), now_s
        return now_s - before_s < _REPEATED_S


def put_off(number: int, frame: FrameType | None) -> bool:
    """Whether a signal came while code runs that no exception leaves; it is delivered again soon then.

    LLVM calls Python while it loads compiled kernels, and the interpreter calls destructors: what is raised there is printed and
    forgotten, and LLVM then runs into a kernel that was not loaded (a segmentation fault).
    """
    while frame is not None:
        if frame.f_code.co_name == "__del__" or frame.f_globals.get("__name__", "").partition(".")[0] in _UNINTERRUPTED:
            again = threading.Timer(_AGAIN_S, _thread.interrupt_main, (number,))
            again.daemon = True
            again.start()
            return True
        frame = frame.f_back
    return False


def heeded(numbers: Iterable[signal.Signals]) -> list[signal.Signals]:
    """Those to handle: `nohup` ignores hang-ups, a shell Ctrl-C for what it starts in the background, and that stays so.

    None but in the main thread: only there can they be handled.
    """
    if threading.current_thread() is not threading.main_thread():
        return []
    kept = (HANG_UP, signal.SIGINT)
    return [number for number in numbers if number not in kept or signal.getsignal(number) is not signal.SIG_IGN]


def without_terminal() -> None:
    """What is printed from now on goes nowhere: writing to a terminal that was closed would be an error."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stat.S_ISCHR(os.fstat(stream.fileno()).st_mode):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream.fileno())
                os.close(nowhere)
        except (OSError, ValueError, AttributeError):
            # closed already, or no file at all
            continue


@contextmanager
def handling(numbers: Iterable[int], handler: Any) -> Iterator[Mapping[int, Any]]:
    """Within, `handler` takes these signals; gives the handlers that were there before, which return at the end."""
    before = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield before
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


@contextmanager
def interrupting_at_once() -> Iterator[None]:
    """Within, a request interrupts, after the handler that was there has noted it; elsewhere that may take a second one."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        if put_off(number, frame):
            return
        noting = before[number]
        assert callable(noting)
        noting(number, frame)
        raise KeyboardInterrupt

    noted = [number for number in heeded((signal.SIGINT, *REQUESTS_TO_END)) if callable(signal.getsignal(number))]
    with handling(noted, interrupt) as before:
        yield


def leave_requests_to_parent() -> None:
    """Of a child process: its parent ends it, in order, so that files are finished.

    Ctrl-C and a closed terminal reach every process of the terminal, and services and containers send SIGTERM to all of theirs.
    A child that was asked with SIGTERM and is not ended by its parent ends by itself after a while.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if HANG_UP is not None:
        signal.signal(HANG_UP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _end_later)


def _end_later(number: int, frame: FrameType | None) -> None:
    later = threading.Timer(_GRACE_S, os._exit, (128 + number,))
    later.daemon = True
    later.start()


# Waiting for work that ends by itself, as long as it makes progress.

_LOOK_S = 0.05


def wait_while_working(progress: Callable[[], Any], patience_s: float, tell: Callable[[], None] = lambda: None) -> bool:
    """Wait until `progress()` is empty; False where it has stayed the same for `patience_s` instead.

    `tell` is called several times a second.
    """
    before, since_s = None, time.monotonic()
    while now := progress():
        if now != before:
            before, since_s = now, time.monotonic()
        elif time.monotonic() - since_s > patience_s:
            return False
        tell()
        time.sleep(_LOOK_S)
    return True
