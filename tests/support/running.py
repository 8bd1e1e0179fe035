"""A process of a test whose output is read as it comes; no wait is without a limit, not even inside a read."""

import os
import queue
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any, TypeVar

T = TypeVar("T")
PATIENCE_S = 60.0
_LOOK_S = 0.5


def python(
    *words: str, limit_s: float = 2 * PATIENCE_S, cwd: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """A run of Python to its end, with what it printed; its environment is that of this process, and these variables."""
    environ = {**os.environ, **environment}
    return subprocess.run(
        [sys.executable, *words], capture_output=True, text=True, timeout=limit_s, env=environ, check=False, cwd=cwd
    )


def printed(*words: str, **more: Any) -> str:
    """What a run of Python prints that succeeds; the rest as `python`."""
    done = python(*words, **more)
    assert done.returncode == 0, done.stderr
    return done.stdout


class Lines:
    """Lines of a stream, read in a thread of their own.

    Attributes:
        seen: the lines that were waited through, in order.
    """

    def __init__(self, stream: IO[str]) -> None:
        self.seen: list[str] = []
        self._queue: queue.Queue[str | None] = queue.Queue()
        self._thread = threading.Thread(target=self._read, args=(stream,), daemon=True)
        self._thread.start()

    def until(self, found: Callable[[str], T | None], limit_s: float = PATIENCE_S, wanted: str = "the line") -> T:
        """What `found` makes of the first line for which that is not None or False; AssertionError at the limit or the end."""
        end_s = time.monotonic() + limit_s
        while (left_s := end_s - time.monotonic()) > 0:
            try:
                line = self._queue.get(timeout=min(_LOOK_S, left_s))
            except queue.Empty:
                continue
            if line is None:
                self._queue.put(None)
                raise AssertionError(f"{wanted} never came; the output ended: {''.join(self.seen)}")
            self.seen.append(line)
            if got := found(line):
                return got
        raise AssertionError(f"{wanted} did not come within {limit_s:g} s in: {''.join(self.seen)}")

    def wait_for(self, pattern: str, limit_s: float = PATIENCE_S) -> re.Match[str]:
        """The match of a regular expression in the first line that has one."""
        return self.until(lambda line: re.search(pattern, line), limit_s, repr(pattern))

    def rest(self, limit_s: float = PATIENCE_S) -> str:
        """All that was and will be written, to the end of the stream."""
        self._thread.join(limit_s)
        assert not self._thread.is_alive(), f"the output did not end within {limit_s:g} s: {''.join(self.seen)}"
        while (line := self._queue.get_nowait()) is not None:
            self.seen.append(line)
        self._queue.put(None)
        return "".join(self.seen)

    def _read(self, stream: IO[str]) -> None:
        try:
            for line in stream:
                self._queue.put(line)
        except ValueError:
            pass  # closed under the reader
        self._queue.put(None)


class Running:
    """A process and the lines of its output. As a context manager it is killed at the end.

    Args:
        command, more: as `subprocess.Popen` takes them.
    """

    def __init__(self, command: Sequence[str], **more: Any) -> None:
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **more)
        self.out, self.err = Lines(self.process.stdout), Lines(self.process.stderr)

    def __enter__(self) -> "Running":
        return self

    def __exit__(self, *problem: object) -> None:
        self.process.kill()
        self.process.wait(PATIENCE_S)

    def finished(self, limit_s: float = PATIENCE_S) -> tuple[str, str]:
        """All its output, once it has ended; killed, and an AssertionError, when it does not end within the limit."""
        try:
            self.process.wait(limit_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise AssertionError(f"still running after {limit_s:g} s: {self.err.rest()}") from None
        return self.out.rest(), self.err.rest()
