"""The process of one job, started by `jobs`: what it does, by the public API, and how it reports.

A function NAME_job makes something of recordings; other work is ``run`` of a module NAME in here. Each takes arguments with names
in the workspace, and gives JSON values.
"""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import posefuse as pf
from posefuse.api.recording import needs_detections
from posefuse.core import InputError, PosefuseError
from posefuse_studio.jobs import JOBS_FOLDER, Job, Jobs, Report
from posefuse_studio.workspace import SessionAddress, StudioWorkspace, address_file, write_stored

Arguments = Mapping[str, Any]
Result = Mapping[str, Any]
_EVERY_S = 0.2
_ALIVE_S = 1.0
_MOST_NEWS = 50


class JobReporter:
    """A `Progress` that keeps the job's state file up to date, from a thread of its own, and notices a request to cancel.

    Attributes:
        cancelled: set when the job was asked to end; the main thread is interrupted then.
    """

    def __init__(self, workspace: StudioWorkspace, job: str) -> None:
        self.cancelled, self._workspace = threading.Event(), workspace
        self._address, self._folder = address_file(workspace.root, job), workspace.path(f"{JOBS_FOLDER}/{job}")
        self._lock = threading.Lock()
        self._report = Report(state="running", pid=os.getpid())
        self._written: tuple[Report, float] = self._report, 0.0
        self._over = threading.Event()
        self._write()
        self._thread = threading.Thread(target=self._run, name="report", daemon=True)
        self._thread.start()

    def __call__(self, stage: str, done: int, total: int | None, message: str = "") -> None:
        """See `Progress`."""
        with self._lock:
            news = (*self._report.news, *([self._workspace.in_names(message)] if message else []))[-_MOST_NEWS:]
            self._report = replace(self._report, stage=stage, done=done, total=total, news=news)

    def note(self, message: str) -> None:
        """A line of news within the stage."""
        self(self._report.stage, self._report.done, self._report.total, message)

    def listens(self, address: SessionAddress) -> None:
        """Let servers of this user reach the session, until its end."""
        write_stored(self._address, address)

    def end(self, **changes: Any) -> None:
        """Write the last report."""
        self._address.unlink(missing_ok=True)
        self._over.set()
        self._thread.join()
        with self._lock:
            self._report = replace(self._report, **changes)
        self._write()

    def _run(self) -> None:
        while not self._over.wait(_EVERY_S):
            gone = not self._folder.is_dir()
            if (gone or (self._folder / "cancel").exists()) and not self.cancelled.is_set():
                self.cancelled.set()
                interrupt_main_thread()
            if gone:
                # a workspace that was deleted: no one can ask for the result, or for the end, any more
                return
            written, written_s = self._written
            if self._report != written or time.monotonic() - written_s > _ALIVE_S:
                self._write()

    def _write(self) -> None:
        with self._lock:
            report = self._report
            self._written = report, time.monotonic()
        # a full disk must not end the work: its next report may find room
        with suppress(InputError, OSError):
            write_stored(self._folder / "state.json", replace(report, reported_s=time.time()))


def carry_out(workspace: StudioWorkspace, job: Job, reporter: JobReporter) -> None:
    """Do the work and write how it ended."""

    def warned(message: Warning | str, *rest: Any, **more: Any) -> None:
        reporter.note(f"warning: {message}")

    warnings.showwarning = warned
    try:
        run = globals().get(f"{job.work}_job") or import_module(f"{__name__}.{job.work}").run
        result: Result = run(job.arguments, workspace, reporter)
        reporter.end(state="done", result=dict(result))
    except KeyboardInterrupt:
        reporter.end(state="cancelled", error="cancelled; what was finished is kept")
    except PosefuseError as error:
        reporter.end(state="failed", error=workspace.in_names(str(error)))
    except Exception as error:  # noqa: BLE001 - a bug of the work is shown on the page and kept in the log
        traceback.print_exc()
        reporter.end(state="failed", error=workspace.in_names(f"{type(error).__name__}: {error} (the log has the trace)"))


def interrupt_main_thread() -> None:
    """Raise KeyboardInterrupt in the main thread, also while it waits for something."""
    main_thread = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main_thread is not None:
        # a signal wakes a thread that waits; an interrupt by the interpreter alone does not
        signal.pthread_kill(main_thread, signal.SIGINT)
    else:
        _thread.interrupt_main()


def main() -> None:
    """Entry point: ``WORKSPACE JOB``."""
    # an interrupt from a terminal is for the server; a job is ended by `cancel`, a machine that shuts down by SIGTERM
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    workspace = StudioWorkspace(Path(sys.argv[1]))
    job = Jobs(workspace).job(sys.argv[2])
    if job is None or not job.work.isidentifier():
        raise SystemExit(f"no job {sys.argv[2]}")
    carry_out(workspace, job, JobReporter(workspace, job.id))


def report_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """The report of ``result``: angles, gait, files for other programs, one page."""
    progress("read", 0, None, f"reading {arguments['result']}")
    made = pf.read(workspace.existing(arguments["result"]), observed=False).report(progress=progress)
    return {"page": workspace.name_of(next(path for path in made if path.suffix == ".html"))}


def export_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """Files of ``result`` in the ``formats`` (names of outputs) of other programs, to ``out``."""
    out = workspace.path(arguments["out"])
    progress("read", 0, None, f"reading {arguments['result']}")
    recording = pf.read(workspace.existing(arguments["result"]), observed=needs_detections(arguments["formats"]))
    made = recording.export(out, arguments["formats"], within=workspace.root, progress=progress)
    return {"files": [workspace.name_of(path) for path in made.files], "failed": dict(made.failed)}


def solve_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """``result`` solved again with ``edits`` (plain values of `Edits`), to ``out``."""
    from posefuse.foundation.settings import settings_from_mapping

    edits = settings_from_mapping(arguments["edits"], pf.Edits, where="edits")
    source, out = workspace.existing(arguments["result"]), workspace.path(arguments["out"])
    progress("solve", 0, None, f"solving {arguments['result']} again")
    pf.solve(source, out, edits=edits, settings={"outputs": ()}, progress=progress)
    return {"recordings": [arguments["out"]]}


def batch_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """Every session of ``study``, to ``out``, by the ``networks`` of a name; empty: the usual ones."""
    place, out = workspace.existing(arguments["study"]), workspace.path(arguments["out"])
    study = pf.batch(place, out, networks=arguments.get("networks") or None, progress=progress)
    for name, reason in study.failed.items():
        progress("batch", len(study.trials), len(study.trials), f"warning: {name}: {reason}")
    return {"files": [workspace.name_of(study.table)], "failed": dict(study.failed)}


def simulate_walk_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """A test walk in a planned room (file ``scene``), rendered to ``session``, tracked to ``out``, compared with its truth."""
    session, out = workspace.path(arguments["session"]), workspace.path(arguments["out"])
    pf.simulate(workspace.existing(arguments["scene"]), session, progress=progress)
    mpjpe_mm = pf.track(session, out=out, formats=(), progress=progress).figures["mpjpe_mm"]
    progress("done", 1, 1, f"mean error {mpjpe_mm:.1f} mm against the exact truth")
    return {"recordings": [arguments["out"]], "mpjpe_mm": mpjpe_mm}
