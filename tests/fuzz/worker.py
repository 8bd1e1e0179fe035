"""A process that reads damaged files one after the other; `drive` restarts it when it crashes or hangs.

What libraries print goes to a file, in which warnings and traces count against the reader.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import shlex
import signal
import sys
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

from examples import DEMO, EXAMPLES
from posefuse.core import InputError, PosefuseError

_LONGEST_LINE = 4000
# a UserWarning is posefuse's own line about what it left out; these come from libraries, about input that posefuse did not check
_NOISE = re.compile(r"Traceback|(Runtime|Deprecation|Future|Syntax|Resource)Warning:")
_ENDED_WELL, _KNOWN_ERROR = 0, 1


def _misbehave(what: str) -> None:
    """Deliberate failures that the fuzz stage must detect, see `test_fuzz`."""
    if what == "trace":
        raise KeyError("a bug")
    if what == "warning":
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)
    if what == "hang":
        threading.Event().wait(3600)
    if what == "crash":
        os.kill(os.getpid(), signal.SIGTERM)
    if what == "clear":
        raise InputError("a clear line")


def _command(kind: str, path: Path, folder: Path) -> list[str]:
    if kind.startswith("compare"):
        return ["compare", str(folder / "sound.trc"), str(path)]
    if kind.startswith("options"):
        return [word.replace("FOLDER", str(folder)) for word in shlex.split(path.read_text())]
    out = ["--out", str(folder.with_name("out"))]
    if kind.startswith(("report", "export", "solve")):
        return [kind.partition(",")[0], str(folder), *out]
    command = ["track", str(folder), *out, "--set", "raw=true", "--outputs", "csv"]
    if kind == "track, MP4":
        command += ["--set", "detector.name=oracle", "--set", f"detector.options.truth={DEMO / 'truth' / 'truth.npz'}"]
        command += ["--end", "0.3"]
    return command


def _reader(kind: str) -> Callable[[Path], object] | None:
    if kind.startswith("self-test "):
        return lambda _: _misbehave(kind.removeprefix("self-test "))
    return EXAMPLES[kind].read if kind in EXAMPLES else None


def _outcome(kind: str, path: Path, folder: Path) -> tuple[str, str]:
    """The outcome: "accepted", "clear", or "trace" with the error that was raised."""
    if read := _reader(kind):
        try:
            read(path)
        except PosefuseError as error:
            text = str(error)
            return ("clear", text) if "\n" not in text and len(text) < _LONGEST_LINE else ("trace", f"not one line: {text[:300]}")
        except Exception:  # noqa: BLE001 - any exception is a finding
            return "trace", traceback.format_exc()
        return "accepted", ""
    from posefuse.cli.main import main

    try:
        code = main(_command(kind, path, folder))
    except SystemExit as ended:
        code = int(ended.code or 0)
    if code not in (_ENDED_WELL, _KNOWN_ERROR):
        return "trace", f"exit code {code}"
    return ("accepted" if code == _ENDED_WELL else "clear"), ""


def _end_at(cpu_s: float) -> None:
    """At this processor time the system ends the process, whatever it is in; on Windows waiting alone is limited."""
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(cpu_s), resource.getrlimit(resource.RLIMIT_CPU)[1]))


def answers(requests: Connection) -> None:
    """Give (outcome, detail) for every (kind, folder, file, limit of processor time in s) until the other side closes."""
    warnings.simplefilter("always")
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
        requests.send("ready")
        while True:
            kind, folder, file, limit_s = requests.recv()
            _end_at(sum(os.times()[:2]) + limit_s)
            said.seek(0)
            said.truncate()
            outcome, detail = _outcome(kind, folder / file, folder)
            for stream in (sys.stdout, sys.stderr):
                with contextlib.suppress(OSError, ValueError):
                    stream.flush()
            said.seek(0)
            noise = said.read().decode("utf-8", errors="replace")
            if outcome != "trace" and _NOISE.search(noise):
                outcome, detail = "trace", "printed"
            requests.send((outcome, f"{detail}\n{noise[-3000:]}" if outcome == "trace" else detail))
