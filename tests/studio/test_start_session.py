"""One live session at a time, which gets the cameras."""

from pathlib import Path
from typing import Any

import pytest
from checks import refusal

from posefuse.core import InputError
from posefuse_studio import jobs as jobs_module
from posefuse_studio.jobs import LIVE, WATCH, Jobs
from posefuse_studio.workspace import StudioWorkspace


class Idle:
    """Stands for the process of a job: it reports nothing yet."""

    returncode = None

    def __init__(self, *_: Any, **__: Any) -> None:
        pass

    def poll(self) -> None:
        """It runs."""


@pytest.fixture
def jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Jobs:
    monkeypatch.setattr(jobs_module.subprocess, "Popen", Idle)
    return Jobs(StudioWorkspace(tmp_path))


def cancelled(jobs: Jobs, job: str) -> bool:
    return (jobs._folder(job) / "cancel").exists()


def test_start_pressed_twice_starts_one_session(jobs: Jobs) -> None:
    jobs.start(LIVE, "one", {})
    jobs.start(LIVE, "two", {})
    assert [job.title for job in jobs.running(LIVE)] == ["one"] and len(jobs.all()) == 1


def test_a_session_takes_cameras_that_are_only_looked_at(jobs: Jobs) -> None:
    looking = jobs.start(WATCH, "Images of 2 cameras", {"sources": {}})
    jobs.start(LIVE, "one", {})
    assert cancelled(jobs, looking.id) and [job.title for job in jobs.running(LIVE)] == ["one"]


def test_a_session_waits_for_a_calibration_that_is_recorded(jobs: Jobs) -> None:
    recording = jobs.start(WATCH, "Recording calibrations/room/verify-1", {"record": "calibrations/room/verify-1"})
    refusal(InputError, r"Recording calibrations/room/verify-1.*stop it first", jobs.start, LIVE, "one", {})
    assert not cancelled(jobs, recording.id) and jobs.running(LIVE) == []
