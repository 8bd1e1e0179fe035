"""The jobs that belong to a page, with the result of them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any
from urllib.parse import urlencode

from nicegui import ui

from .jobs import Job, Report
from .shell import card, job_line
from .state import Studio
from .workspace import recording_place

_POLL_S = 1.0
# older work is in the jobs menu
_SHOWN_S, _MOST = 3600.0, 4


def job_cards(studio: Studio, works: Sequence[str], *, about: str = "") -> None:
    """Newest jobs of these kinds that began within an hour; `about`: only those with this value among their arguments."""
    shown: list[Any] = []
    place = ui.column().classes("pf-job-cards")

    def refresh() -> None:
        jobs = [job for job in studio.jobs.all() if job.work in works and abs(time.time() - job.begun_s) < _SHOWN_S]
        jobs = [job for job in jobs if not about or about in job.arguments.values()][:_MOST]
        state = [(job, studio.jobs.report(job.id).without_time) for job in jobs]
        if state == shown:
            return
        shown[:] = state
        place.clear()
        with place:
            for job, report in state:
                _card(studio, job, report)

    refresh()
    ui.timer(_POLL_S, refresh)


def _card(studio: Studio, job: Job, report: Report) -> None:
    with card():
        job_line(studio, job)
        if report.news and not report.error:
            ui.label(report.news[-1]).classes("pf-small")
        result_links(report)


def result_links(report: Report) -> None:
    """What a job that is done has made."""
    if report.state == "done":
        with ui.row():
            _links(report)


def _links(report: Report) -> None:
    result = report.result
    if "page" in result:
        ui.link("Open the page", file_address(result["page"]), new_tab=True)
    for name in (*([result["result"]] if "result" in result else ()), *result.get("recordings", ())):
        ui.link(f"Open {recording_place(name).name}", f"/recordings?{urlencode({'open': name})}")
    for name in result.get("files", ()):
        ui.link(name.split("/")[-1], file_address(name)).props("download")


def file_address(name: str) -> str:
    """Where a file of the workspace is fetched."""
    return f"/studio/file?{urlencode({'name': name})}"
