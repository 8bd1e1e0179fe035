"""Long work in processes of its own, whose state is in files: it continues when a page, a connection or the server ends.

Each job is a folder ``.posefuse-studio/jobs/ID`` of the workspace: ``job.json`` has the task, ``state.json`` its progress,
``log.txt`` has what it printed, and a file ``cancel`` asks it to stop. Any server of the same user that serves the workspace
finds them; files of another user are none. What has ended is read once.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from posefuse.core import InputError

from .private_files import SessionAddress, read_address, read_own, write_own
from .session_messages import WATCH
from .workspace import STATE_FOLDER, StudioWorkspace

JobState = Literal["starting", "running", "done", "failed", "cancelled", "lost"]
ENDED = ("done", "failed", "cancelled", "lost")
JOBS_FOLDER = f"{STATE_FOLDER}/jobs"
# a process reports once a second; one that is silent for this long is dead
_LOST_S = 15.0
_STARTING_S = 60.0
_MOST_NEWS = 50


@dataclass(frozen=True, kw_only=True)
class Job:
    """What a job is to do.

    Attributes:
        id: name of its folder. work: what does it, see `posefuse_studio.work`. title: one line for people.
        arguments: JSON values for it. page: where its result is shown, e.g. ``/recordings``. begun_s: Unix time.
    """

    id: str
    work: str
    title: str
    arguments: Mapping[str, Any]
    page: str = "/"
    begun_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Report:
    """How far a job is.

    Attributes:
        stage, done, total: see `posefuse.Progress`. news: its newest lines, oldest first.
        error: one line. result: JSON values that `run` returned. pid: of its process. reported_s: Unix time of the report.
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
        return self.state in ENDED

    @property
    def fraction(self) -> float | None:
        """Of the stage; None where the total is not known."""
        return min(1.0, self.done / self.total) if self.total else None

    @property
    def without_time(self) -> Report:
        """What a page shows of it: a button that is replaced every second could not be pressed."""
        return replace(self, reported_s=0.0)

    def advanced(self, stage: str, done: int, total: int | None, message: str = "") -> Report:
        """With one call of `Progress`."""
        news = (*self.news, message)[-_MOST_NEWS:] if message else self.news
        return replace(self, stage=stage, done=done, total=total, news=news)


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

    def start(self, work: str, title: str, arguments: Mapping[str, Any], *, page: str = "/") -> Job:
        """Begin; returns at once.

        Args:
            work, title, arguments, page: see `Job`.

        Raises:
            InputError: the workspace cannot be written to.
        """
        stamp = time.strftime("%Y%m%d-%H%M%S")
        name = self._workspace.free_name(JOBS_FOLDER, f"{stamp}-{work}")
        folder = self._workspace.folder(name)
        job = Job(id=folder.name, work=work, title=title, arguments=dict(arguments), page=page, begun_s=time.time())
        write_json(folder / "job.json", asdict(job))
        with (folder / "log.txt").open("wb") as log:
            # -P: files of the workspace cannot stand in for modules
            self._processes[job.id] = subprocess.Popen(
                [sys.executable, "-P", "-m", "posefuse_studio.job_process", str(self._workspace.root), job.id],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                cwd=self._workspace.root,
                start_new_session=sys.platform != "win32",
            )
        return job

    def all(self, work: str = "") -> list[Job]:
        """All jobs of the workspace, the newest first; of one kind of work where it is given."""
        place = self._workspace.path(JOBS_FOLDER)
        names = sorted(os.listdir(place), reverse=True) if place.is_dir() else []  # noqa: PTH208 - names alone, of hundreds
        found = [job for name in names if work in name and (job := self.job(name)) is not None]
        return [job for job in found if work in ("", job.work)]

    def job(self, job_id: str) -> Job | None:
        """By its id; None where there is none, or its file is damaged or of another user."""
        if job_id not in self._tasks:
            try:
                job = _JOB.validate_python(read_own(self._folder(job_id) / "job.json") | {"id": job_id})
            except (InputError, ValidationError):
                return None
            self._tasks[job_id] = job if _is_page(job.page) else replace(job, page="/")
        return self._tasks[job_id]

    def report(self, job_id: str) -> Report:
        """How far it is now."""
        if job_id in self._ended:
            return self._ended[job_id]
        self._reap(job_id)
        folder = self._folder(job_id)
        try:
            report = _REPORT.validate_python(read_own(folder / "state.json"))
        except ValidationError:
            # as of one that has reported nothing
            report = Report()
        if report.ended:
            self._ended[job_id] = report
            return report
        job = self.job(job_id)
        silent_s = self._silent_s(job_id, report.reported_s or (job.begun_s if job else 0.0))
        process = self._processes.get(job_id)
        died = process is not None and process.returncode is not None
        if not died and silent_s <= (_LOST_S if report.reported_s else _STARTING_S):
            return report
        return replace(report, state="lost", error=self._last_words(folder) or "its process ended without a report")

    def _silent_s(self, job_id: str, reported_s: float) -> float:
        """Since its newest report; that of the first one read is a time of the wall clock, in the future as wrong as long ago."""
        now_s, heard = time.monotonic(), self._heard.get(job_id)
        if heard is None or heard[0] != reported_s:
            late_s = abs(time.time() - reported_s) if heard is None else 0.0
            heard = self._heard[job_id] = reported_s, now_s - late_s
        return now_s - heard[1]

    def address(self, job_id: str) -> SessionAddress | None:
        """Where its process listens; None where it does not."""
        return read_address(self._workspace.root, job_id)

    def running(self, work: str = "") -> list[Job]:
        """Jobs that have not ended, the newest first; of one kind of work where it is given."""
        return [job for job in self.all(work) if not self.report(job.id).ended]

    def cancel(self, job_id: str) -> None:
        """Ask it to end; what it has finished stays."""
        folder = self._folder(job_id)
        if folder.is_dir():
            (folder / "cancel").touch()

    def free_cameras(self) -> None:
        """End what only looks at cameras, before something else opens them; raises InputError while a calibration is recorded."""
        for job in self.running(WATCH):
            if job.arguments.get("record"):
                raise InputError(f"{job.title}: it needs the cameras; stop it first")
            self.cancel(job.id)

    def log(self, job_id: str, most_bytes: int = 20_000) -> str:
        """The end of what it printed."""
        try:
            return (self._folder(job_id) / "log.txt").read_bytes()[-most_bytes:].decode(errors="replace")
        except OSError:
            return ""

    def _folder(self, job_id: str) -> Path:
        if "/" in job_id:
            raise InputError(f"job {job_id!r}: expected the name of one job")
        return self._workspace.path(f"{JOBS_FOLDER}/{job_id}")

    def _reap(self, job_id: str) -> None:
        if (process := self._processes.get(job_id)) is not None:
            process.poll()

    def _last_words(self, folder: Path) -> str:
        lines = [line for line in self.log(folder.name).splitlines() if line.strip()]
        return lines[-1].strip() if lines else ""


_JOB, _REPORT = TypeAdapter(Job), TypeAdapter(Report)


def _is_page(address: object) -> bool:
    """Whether it is the path of a page of the studio: a browser would run ``javascript:``, and leave with ``//`` or ``/\\``."""
    return isinstance(address, str) and address.startswith("/") and address[1:2] not in ("/", "\\") and address.isprintable()


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Whole or not at all, readable by its owner only."""
    write_own(path, json.dumps(content))


def read_json_or_empty(path: Path) -> dict[str, Any]:
    """Empty where the file is missing or damaged."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
