"""Jobs run in processes of their own; their state is in files that any server of the workspace reads."""

import os
import shutil
import signal
import threading
import time
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest
from checks import refusal
from live_session import until

from posefuse.core import InputError
from posefuse_studio import jobs as jobs_module
from posefuse_studio import work
from posefuse_studio.jobs import JOBS_FOLDER, LIVE, WATCH, Job, Jobs, Report
from posefuse_studio.shell import LIGHTS, page_of, state_of
from posefuse_studio.workspace import StudioWorkspace, read_stored, write_stored


def done(workspace: StudioWorkspace, run: Callable[..., Mapping[str, Any]], monkeypatch: pytest.MonkeyPatch) -> Report:
    """The report of a job whose work is `run`, done in this process."""
    workspace.folder(f"{JOBS_FOLDER}/one")
    job = Job(id="one", work="made_up", title="Made up", arguments={"n": 3}, begun_s=time.time())
    monkeypatch.setattr(work, "import_module", lambda name: SimpleNamespace(run=run))
    # a test runner may ignore interrupts; a job's process does not
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        work.carry_out(workspace, job, work.JobReporter(workspace, "one"))
    finally:
        signal.signal(signal.SIGINT, before)
    return Jobs(workspace).report("one")


def stored_job(workspace: StudioWorkspace, job: str, state: Mapping[str, Any] | None = None, **task: Any) -> Path:
    """The folder of a job with its files; without a state it has not reported."""
    folder = workspace.folder(f"{JOBS_FOLDER}/{job}")
    write_stored(folder / "job.json", {"id": "other", "work": "report", "title": "T", "arguments": {}, **task})
    if state is not None:
        write_stored(folder / "state.json", state)
    return folder


def ended(workspace: StudioWorkspace, number: int, **task: Any) -> str:
    """A job that is done."""
    return stored_job(workspace, f"20260101-{number:06d}-report", {"state": "done", "reported_s": 1.0}, **task).name


def test_progress_news_and_result_are_reported(workspace: StudioWorkspace, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(arguments: Mapping[str, Any], place: StudioWorkspace, progress: Any) -> Mapping[str, Any]:
        progress("detect", 1, 4, "half a word")
        progress("detect", 2, 4)
        return {"twice": 2 * arguments["n"]}

    report = done(workspace, run, monkeypatch)
    assert (report.state, report.stage, report.fraction, report.news) == ("done", "detect", 0.5, ("half a word",))
    assert report.result == {"twice": 6} and report.ended


def test_a_known_fault_is_one_line_and_a_bug_is_named(workspace: StudioWorkspace, monkeypatch: pytest.MonkeyPatch) -> None:
    refusing, faulty = Mock(side_effect=InputError("no such\nfolder")), Mock(side_effect=ZeroDivisionError("by zero"))
    assert done(workspace, refusing, monkeypatch).error == "no such folder"
    elsewhere = Mock(side_effect=InputError(f"{workspace.root / 'walks' / 'one'}: not a recording"))
    assert done(workspace, elsewhere, monkeypatch).error == f"{Path('walks', 'one')}: not a recording"
    warning = Mock(side_effect=lambda *_: warnings.warn(f"{workspace.root / 'walks' / 'one'}: is damaged", stacklevel=1) or {})
    assert done(workspace, warning, monkeypatch).news == (f"warning: {Path('walks', 'one')}: is damaged",)
    assert done(workspace, faulty, monkeypatch).error.startswith("ZeroDivisionError: by zero")


def test_a_cancelled_job_is_interrupted(workspace: StudioWorkspace, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*_: Any) -> Mapping[str, Any]:
        Jobs(workspace).cancel("one")
        threading.Event().wait(20.0)
        return {}

    assert done(workspace, run, monkeypatch).state == "cancelled"


def test_a_job_whose_workspace_was_deleted_ends(workspace: StudioWorkspace, monkeypatch: pytest.MonkeyPatch) -> None:
    went_on = Mock()

    def run(*_: Any) -> Any:
        shutil.rmtree(workspace.path(f"{JOBS_FOLDER}/one"))
        threading.Event().wait(20.0)
        went_on()

    done(workspace, run, monkeypatch)
    assert not went_on.called


def test_a_job_that_stopped_reporting_is_lost_with_its_last_words(workspace: StudioWorkspace) -> None:
    jobs = Jobs(workspace)
    folder = stored_job(workspace, "old", {"state": "running", "reported_s": time.time()}, begun_s=time.time() - 500)
    assert jobs.report("old").state == "running" and [job.id for job in jobs.running()] == ["old"]
    jobs = Jobs(workspace)
    write_stored(folder / "state.json", {"state": "running", "reported_s": time.time() - 100})
    (folder / "log.txt").write_text("Killed\n\n", encoding="utf-8")
    assert (jobs.report("old").state, jobs.report("old").error) == ("lost", "Killed")
    assert jobs.running() == []


@pytest.mark.parametrize("jump_s", [-7200.0, 7200.0])
def test_a_job_that_reports_is_not_lost_when_the_clock_is_set(workspace: StudioWorkspace, monkeypatch, jump_s: float) -> None:
    jobs, real = Jobs(workspace), time.time
    stored_job(workspace, "one", begun_s=real())
    reporter = work.JobReporter(workspace, "one")
    try:
        before = jobs.report("one")
        monkeypatch.setattr(time, "time", lambda: real() + jump_s)
        assert before.state == jobs.report("one").state == "running"
        # its next reports come, too
        until(lambda: jobs.report("one").reported_s != before.reported_s)
        assert jobs.report("one").state == "running"
    finally:
        reporter.end(state="done")


@pytest.mark.parametrize("jump_s", [-7200.0, 7200.0])
def test_a_report_of_before_the_clock_was_set_counts_from_its_reading(
    workspace: StudioWorkspace, monkeypatch, jump_s: float
) -> None:
    jobs, real = Jobs(workspace), time.time
    for i in range(2):
        stored_job(workspace, "one", {"state": "running", "reported_s": real() + i}, begun_s=real())
        assert jobs.report("one").state == "running"
        monkeypatch.setattr(time, "time", lambda: real() + jump_s)


def test_damaged_state_is_no_trouble(workspace: StudioWorkspace) -> None:
    jobs = Jobs(workspace)
    folder = workspace.folder(f"{JOBS_FOLDER}/bad")
    (folder / "job.json").write_text("{", encoding="utf-8")
    assert jobs.all() == [] and jobs.job("none") is None
    with pytest.raises(InputError):
        jobs.report("../x")


def test_jobs_come_in_the_order_they_began_whatever_the_clock_on_the_wall_shows(workspace: StudioWorkspace) -> None:
    """The name of a job is in local time, which is set back by an hour in autumn, and one second may begin ten jobs."""
    names = ["20261025-025959-report", "20261025-020001-report", "20261025-020001-report-9", "20261025-020001-report-10"]
    for i, name in enumerate(names):
        stored_job(workspace, name, begun_s=1e9 + i)
    assert [job.id for job in Jobs(workspace).all()] == names[::-1]


def test_what_has_ended_is_read_once(workspace: StudioWorkspace, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [ended(workspace, number) for number in range(500)]
    jobs, read = Jobs(workspace), Mock(side_effect=read_stored)
    monkeypatch.setattr("posefuse_studio.jobs.read_stored", read)
    assert jobs.running() == [] and read.call_count == 2 * len(names)
    for _ in range(3):
        assert jobs.running() == [] and jobs.running("report") == [] and jobs.running("live") == []
        assert [job.id for job in jobs.all()] == names[::-1] and jobs.report(names[0]).ended
    assert read.call_count == 2 * len(names)
    # a new one is seen, and read again until it ends
    folder = stored_job(workspace, "20260102-000000-report", {"state": "running", "reported_s": time.time()})
    assert [job.id for job in jobs.running()] == [folder.name]
    write_stored(folder / "state.json", {"state": "done"})
    assert jobs.running() == []


@pytest.mark.parametrize("reported_s", [1e18, float("inf"), float("nan"), -1e18, "yesterday", [1]])
def test_a_time_that_cannot_be_is_of_no_running_job(workspace: StudioWorkspace, reported_s: Any) -> None:
    stored_job(workspace, "one", {"state": "running", "reported_s": reported_s}, begun_s=reported_s)
    assert Jobs(workspace).running() == []
    # a clock that was set back a little is no reason
    stored_job(workspace, "one", {"state": "running", "reported_s": time.time() + 5}, begun_s=time.time() + 5)
    assert [job.id for job in Jobs(workspace).running()] == ["one"]


@pytest.mark.skipif(not hasattr(os, "O_NOFOLLOW"), reason="this system follows links")
def test_a_link_is_no_state_file(workspace: StudioWorkspace) -> None:
    mine = ended(workspace, 1)
    folder = workspace.folder(f"{JOBS_FOLDER}/link")
    for name in ("job.json", "state.json"):
        (folder / name).symlink_to(workspace.path(f"{JOBS_FOLDER}/{mine}/{name}"))
    assert [job.id for job in Jobs(workspace).all()] == [mine]


@pytest.mark.parametrize(
    ("work", "arguments", "page"),
    [
        (WATCH, {}, "/"), (WATCH, {"folder": "calibrations/room"}, "/calibrate"), ("calibrate", {}, "/calibrate"),
        (LIVE, {}, "/live"), ("simulate_walk", {}, "/simulate"), ("report", {}, "/recordings"), ("else", {}, "/recordings"),
    ],
)  # fmt: skip
def test_a_job_leads_to_pages_of_the_studio_only(
    workspace: StudioWorkspace, work: str, arguments: Mapping[str, Any], page: str
) -> None:
    job = Jobs(workspace).job(ended(workspace, 1, work=work, arguments=arguments, page="javascript:alert(1)"))
    assert job is not None and (page_of(job), job.id) == (page, "20260101-000001-report")


@pytest.mark.parametrize(
    ("report", "shown"),
    [
        (Report(state="done", result={"failed": {"P01/walk1": "cam1: not a video"}}), ("doubt", "1 failed")),
        (Report(state="done", result={"files": ["a.trc"], "failed": {"c3d": "the disk is full"}}), ("doubt", "1 failed")),
        (Report(state="done", result={"failed": {}}), ("good", "done")),
        (Report(state="done", result={"passed": False}), ("bad", "refused")),
        (Report(state="done", result={"passed": True}), ("good", "done")),
        (Report(state="done"), ("good", "done")),
        (Report(state="failed"), ("bad", "failed")),
        (Report(state="running"), ("busy", "running")),
        (Report(), ("busy", "starting")),
    ],
)
def test_what_was_refused_or_failed_in_part_has_no_green_light(report: Report, shown: tuple[str, str]) -> None:
    assert state_of(report) == shown
    assert shown[0] in LIGHTS


# --- one live session at a time, which gets the cameras


@pytest.fixture
def jobs(workspace: StudioWorkspace, monkeypatch: pytest.MonkeyPatch) -> Jobs:
    """Of processes that run and report nothing yet."""
    monkeypatch.setattr(jobs_module.subprocess, "Popen", lambda *_, **__: SimpleNamespace(returncode=None, poll=lambda: None))
    return Jobs(workspace)


def cancelled(jobs: Jobs, job: str) -> bool:
    return (jobs._folder(job) / "cancel").exists()


def test_start_pressed_twice_starts_one_session(jobs: Jobs) -> None:
    jobs.start(LIVE, "one", {})
    jobs.start(LIVE, "two", {})
    assert [job.title for job in jobs.running(LIVE)] == ["one"] and len(jobs.all()) == 1


def test_a_session_takes_cameras_that_are_only_looked_at(jobs: Jobs) -> None:
    looking = jobs.start(WATCH, "Images of left, right", {"sources": {}})
    jobs.start(LIVE, "one", {})
    assert cancelled(jobs, looking.id) and [job.title for job in jobs.running(LIVE)] == ["one"]


def test_a_session_waits_for_a_calibration_that_is_recorded(jobs: Jobs) -> None:
    recording = jobs.start(WATCH, "Recording calibrations/room/verify-1", {"record": "calibrations/room/verify-1"})
    refusal(InputError, r"Recording calibrations/room/verify-1.*stop it first", jobs.start, LIVE, "one", {})
    assert not cancelled(jobs, recording.id) and jobs.running(LIVE) == []
