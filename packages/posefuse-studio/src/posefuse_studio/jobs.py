"""Long work in processes of its own, whose state is in files: it continues when a page, a connection or the server ends.

Each job is a folder ``.posefuse-studio/jobs/ID`` of the workspace: ``job.json`` has the task, ``state.json`` its progress,
``log.txt`` has what it printed, and a file ``cancel`` asks it to stop. Any server of the same user that serves the workspace
finds them; files of another user are none. What has ended is read once.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from posefuse.core import InputError

from .workspace import STATE_FOLDER, SessionAddress, StudioWorkspace, address_file, read_stored, write_stored

LIVE, WATCH = "live", "watch"
"""Kinds of work that look through cameras: pages follow them, and the streams that they draw have these names."""
JobState = Literal["starting", "running", "done", "failed", "cancelled", "lost"]
JOBS_FOLDER = f"{STATE_FOLDER}/jobs"
# a process reports once a second; one that is silent for this long is dead
_LOST_S = 15.0
_STARTING_S = 60.0
_MOST_LOG_BYTES = 20_000


@dataclass(frozen=True, kw_only=True)
class Job:
    """What a job is to do.

    Attributes:
        id: name of its folder. work: what does it, see `posefuse_studio.work`. title: one line for people.
        arguments: JSON values for it. begun_s: Unix time.
    """

    id: str = ""
    work: str
    title: str
    arguments: Mapping[str, Any]
    begun_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Report:
    """How far a job is.

    Attributes:
        stage, done, total: see `posefuse.Progress`. news: its newest lines, oldest first.
        error: one line. result: JSON values that its work returned. pid: of its process. reported_s: Unix time of the report.
    """

    state: JobState = "starting"
    stage: str = ""
    done: int = 0
    total: int | None = None
    news: tuple[str, ...] = ()
    error: str = ""
    result: Mapping[str, Any] = field(default_factory=dict)
    pid: int = 0
    reported_s: float = 0.0

    @property
    def ended(self) -> bool:
        """Whether nothing more will come."""
        return self.state not in ("starting", "running")

    @property
    def fraction(self) -> float | None:
        """Of the stage; None where the total is not known."""
        return min(1.0, self.done / self.total) if self.total else None

    @property
    def without_time(self) -> Report:
        """What a page shows of it: a button that is replaced every second could not be pressed."""
        return replace(self, reported_s=0.0)


class Jobs:
    """Starts, watches and cancels the jobs of a workspace."""

    def __init__(self, workspace: StudioWorkspace) -> None:
        self._workspace = workspace
        # kept so that they are waited for when they end, where this server started them
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        # a task never changes, a report not after its end: with hundreds of them, reading them again would cost the server a core
        self._tasks: dict[str, Job] = {}
        self._ended: dict[str, Report] = {}
        # the time of each job's newest report, and when it came by a clock that no one sets
        self._heard: dict[str, tuple[float, float]] = {}

    def start(self, work: str, title: str, arguments: Mapping[str, Any]) -> Job:
        """Begin, and return at once; arguments as the attributes of `Job`.

        What looks through the cameras takes them from what only shows their images. A live session that runs already stays.

        Raises:
            InputError: the workspace cannot be written to, or a calibration that is being recorded needs the cameras.
        """
        if work == LIVE and (running := self.running(LIVE)):
            return running[0]
        if work in (LIVE, WATCH):
            self._free_cameras()
        name = self._workspace.free_name(JOBS_FOLDER, f"{time.strftime('%Y%m%d-%H%M%S')}-{work}")
        folder = self._workspace.folder(name)
        job = Job(id=folder.name, work=work, title=title, arguments=dict(arguments), begun_s=time.time())
        write_stored(folder / "job.json", job)
        with (folder / "log.txt").open("wb") as log:
            # -P: files of the workspace cannot stand in for modules
            self._processes[job.id] = subprocess.Popen(
                [sys.executable, "-P", "-c", "from posefuse_studio.work import main; main()", str(self._workspace.root), job.id],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                cwd=self._workspace.root,
                start_new_session=sys.platform != "win32",
            )
        return job

    def all(self, *works: str) -> list[Job]:
        """All jobs of the workspace, the newest first; of some kinds of work where these are given."""
        place = self._workspace.path(JOBS_FOLDER)
        names = os.listdir(place) if place.is_dir() else []  # noqa: PTH208 - names alone, of hundreds
        found = [job for name in names if (job := self.job(name)) is not None and (not works or job.work in works)]
        return sorted(found, key=lambda job: (job.begun_s, job.id), reverse=True)

    def job(self, job_id: str) -> Job | None:
        """By its id; None where there is none, or its file is damaged or of another user."""
        if job_id not in self._tasks:
            job = read_stored(self._folder(job_id) / "job.json", Job)
            if job is None:
                return None
            self._tasks[job_id] = replace(job, id=job_id)
        return self._tasks[job_id]

    def report(self, job_id: str) -> Report:
        """How far it is now."""
        if job_id in self._ended:
            return self._ended[job_id]
        process, folder = self._processes.get(job_id), self._folder(job_id)
        died = process is not None and process.poll() is not None
        report = read_stored(folder / "state.json", Report) or Report()
        if report.ended:
            self._ended[job_id] = report
            return report
        job = self.job(job_id)
        silent_s = self._silent_s(job_id, report.reported_s or (job.begun_s if job else 0.0))
        if not died and silent_s <= (_LOST_S if report.reported_s else _STARTING_S):
            return report
        return replace(report, state="lost", error=_last_words(folder) or "its process ended without a report")

    def _silent_s(self, job_id: str, reported_s: float) -> float:
        """Since its newest report; that of the first one read is a time of the wall clock, in the future as wrong as long ago."""
        now_s, heard = time.monotonic(), self._heard.get(job_id)
        if heard is None or heard[0] != reported_s:
            late_s = abs(time.time() - reported_s) if heard is None else 0.0
            heard = self._heard[job_id] = reported_s, now_s - late_s
        return now_s - heard[1]

    def address(self, job_id: str) -> SessionAddress | None:
        """Where its process listens; None where it does not."""
        return read_stored(address_file(self._workspace.root, job_id), SessionAddress)

    def running(self, *works: str) -> list[Job]:
        """Jobs that have not ended, the newest first; of some kinds of work where these are given."""
        return [job for job in self.all(*works) if not self.report(job.id).ended]

    def cancel(self, job_id: str) -> None:
        """Ask it to end; what it has finished stays."""
        folder = self._folder(job_id)
        if folder.is_dir():
            (folder / "cancel").touch()

    def _free_cameras(self) -> None:
        """End what only looks at cameras, before something else opens them."""
        for job in self.running(WATCH):
            if job.arguments.get("record"):
                raise InputError(f"{job.title}: it needs the cameras; stop it first")
            self.cancel(job.id)

    def _folder(self, job_id: str) -> Path:
        if "/" in job_id:
            raise InputError(f"job {job_id!r}: expected the name of one job")
        return self._workspace.path(f"{JOBS_FOLDER}/{job_id}")


def _last_words(folder: Path) -> str:
    """The last line that its process printed."""
    try:
        log = (folder / "log.txt").read_bytes()[-_MOST_LOG_BYTES:].decode(errors="replace")
    except OSError:
        return ""
    return next((line.strip() for line in reversed(log.splitlines()) if line.strip()), "")
