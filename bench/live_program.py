"""A `posefuse live` that a bench watches: what it prints, which of its processes does what, what they use (Linux: /proc)."""

from __future__ import annotations

import contextlib
import json
import re
import signal
import subprocess
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from harness import truth_of

_START_S, _END_S = 180.0, 40.0


def loop_s(session: Path) -> float:
    """Length of a simulated session, for ``--loop``."""
    t_ns = truth_of(session).t_ns
    return round((t_ns[-1] - t_ns[0]) / 1e9 + 1 / 30, 3)


class Program:
    """A command whose notes are kept as they come."""

    def __init__(self, command: Sequence[str]) -> None:
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.notes: list[str] = []
        self._news = threading.Condition()
        self._listening = threading.Thread(target=self._listen, daemon=True)
        self._listening.start()

    def wait_for(self, pattern: str) -> re.Match:
        """The note with this; ends the bench when the program ends before, or after minutes."""
        end_s = time.monotonic() + _START_S
        with self._news:
            while not (found := re.search(pattern, "".join(self.notes))):
                if self.process.poll() is not None or not self._news.wait(max(0.0, end_s - time.monotonic())):
                    raise SystemExit(f"no {pattern!r} in: {''.join(self.notes[-80:])}")
        return found

    def stopped(self) -> dict[str, Any]:
        """Its figures after Ctrl-C."""
        self.process.send_signal(signal.SIGINT)
        out = self.process.stdout.read()
        self.process.wait(_END_S)
        if self.process.returncode:
            raise SystemExit("".join(self.notes[-80:]))
        return json.loads(out)

    def kill(self) -> None:
        self.process.kill()
        self._listening.join()

    def roles(self) -> dict[int, str]:
        """What each of its processes does, by its notes."""
        found = re.findall(r"(cameras|outputs|rig watched)[^;\n]*? in process (\d+)", "".join(self.notes))
        return {self.process.pid: "fusion", **{int(pid): name for name, pid in found}}

    def _listen(self) -> None:
        for line in self.process.stderr:
            with self._news:
                self.notes.append(line)
                self._news.notify()


def children_of(pid: int) -> list[int]:
    with contextlib.suppress(OSError):
        return [int(child) for task in Path(f"/proc/{pid}/task").iterdir() for child in (task / "children").read_text().split()]
    return []


def running(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().split(") ")[1][0] != "Z"
    return False
