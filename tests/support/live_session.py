"""A live session of the bundled clip in processes of its own, with an oracle for the detector."""

import json
import re
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from running import Running

PATIENCE_S, FILLED = 180.0, 1 << 16


FAULTY = Path(__file__).resolve().parents[2] / "bench" / "faulty_live.py"


def command(
    session: Path, *options: str, source: str | None = None, rig: Path | None = None, faults: Sequence[str] = ()
) -> list[str]:
    """The command line of a session; `rig`: another file than the session's own. `faults`: of `bench/faulty_live.py`."""
    oracle = ["--set", "detector.name=oracle", "--set", f"detector.options.truth={session / 'truth' / 'truth.npz'}"]
    oracle += ["--set", "detector.options.noise.sigma_px=1.0"]
    sources = ["--source", source or f"sim:{session}"]
    faulty = [str(FAULTY), *(part for fault in faults for part in ("--fault", fault)), "--"]
    program = [sys.executable, *(faulty if faults else ["-m", "posefuse.cli.main"])]
    return [*program, "live", str(rig or session / "rig.toml"), *sources, *oracle, "--json", *options]


class Live:
    """A running session whose notes are read as they come."""

    def __init__(self, arguments: list[str], **more: Any) -> None:
        self._running = Running(arguments, **more)
        self.process = self._running.process

    def wait_for(self, pattern: str) -> re.Match:
        try:
            return self._running.err.wait_for(pattern, PATIENCE_S)
        except AssertionError:
            self.process.kill()
            raise

    def ended(self, code: int = 0) -> tuple[dict, str]:
        """Its figures and everything on stderr, once it has ended with this exit code."""
        out, err = self._running.finished(PATIENCE_S)
        assert self.process.returncode == code, err
        assert "Traceback" not in err
        return json.loads(out), err

    def figures(self) -> dict:
        return self.ended()[0]


def until(condition: Callable[[], bool], work: Callable[[], object] | None = None) -> None:
    """Wait, doing this meanwhile."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        if work is not None:
            work()
        time.sleep(0.005 if work else 0.05)


def fill(path: Path) -> None:
    """Fill the disk to its last byte."""
    with path.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(FILLED))
        except OSError:
            return
