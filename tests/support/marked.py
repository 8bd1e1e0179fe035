"""Processes that a test has started, with all that these have started: found by a mark in their environment, on Linux."""

import contextlib
import os
import time
from pathlib import Path

import pytest

MARK, LEAVE_S = "POSEFUSE_TEST_MARK", 30.0
ON_LINUX = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="processes are found by /proc")


def new_mark() -> tuple[str, dict[str, str]]:
    """A mark, and the environment for a process that has it."""
    mark = f"{os.getpid()}-{time.monotonic_ns()}"
    return mark, {**os.environ, MARK: mark, "COLUMNS": "500"}


def marked(mark: str) -> dict[int, str]:
    """Command lines of what runs, by process id; what has ended and is not waited for has none."""
    found = {}
    for place in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if f"{MARK}={mark}".encode() in (place / "environ").read_bytes():
                found[int(place.name)] = (place / "cmdline").read_bytes().replace(b"\0", b" ").decode()
    return {pid: line for pid, line in found.items() if line}


def left(mark: str) -> list[str]:
    """What still runs some seconds later."""
    end_s = time.monotonic() + LEAVE_S
    while (found := marked(mark)) and time.monotonic() < end_s:
        time.sleep(0.1)
    return list(found.values())
