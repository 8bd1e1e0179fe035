"""What every page has: one style, the navigation, the jobs that run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import segno
from nicegui import ui

from .access import is_loopback
from .jobs import Job, Report
from .pages import PAGES, StudioPage
from .session_messages import LIVE, WATCH
from .state import Studio

_STYLE = Path(__file__).with_name("style.css")
_POLL_S = 1.0
_MOST_JOBS = 8


@contextmanager
def shell(studio: Studio, here: StudioPage) -> Iterator[None]:
    """The frame of a page; its own elements go into the block."""
    dark = apply_style()
    with ui.header(elevated=False).classes("pf-header"):
        with ui.link(target="/").classes("pf-brand"):
            ui.html(_LOGO, sanitize=False)
            ui.label("posefuse studio")
        with ui.row().classes("pf-nav").props('role="navigation" aria-label="Pages"'):
            for page in PAGES:
                _nav_link(page, here)
        ui.space()
        with ui.button(icon="qr_code_2", color=None, on_click=lambda: _phone(studio)).props(
            'flat round dense aria-label="Phone"'
        ):
            ui.tooltip("On a phone")
        _jobs_menu(studio)
        with ui.button(icon="contrast", color=None, on_click=lambda: dark.set_value(not dark.value)).props(
            'flat round dense aria-label="Light or dark"'
        ):
            ui.tooltip("Light or dark")
    with ui.footer().classes("pf-bottom").props('role="navigation" aria-label="Pages"'):
        for page in PAGES:
            _nav_link(page, here)
    with ui.column().classes("pf-page").props('role="main"'):
        yield


def apply_style() -> ui.dark_mode:
    """The style alone."""
    ui.add_css(_STYLE)
    ui.colors(primary="#00897b", secondary="#455a64", accent="#ef6c00", positive="#2e7d32", negative="#c62828", warning="#f9a825")
    return ui.dark_mode(None)


def _phone(studio: Studio) -> None:
    """How to look from a phone: a QR code, or what is needed for one."""
    access = studio.access
    with ui.dialog(value=True), ui.card().classes("gap-3 items-center"):
        ui.label("Look from a phone").classes("pf-h2")
        if is_loopback(access.host):
            ui.label(
                "The studio is reached from this machine only. To let a phone in the same network look, start it again with"
            ).classes("pf-small")
            ui.code(f"posefuse studio {studio.workspace.root} --host 0.0.0.0", language="bash")
            return
        picture = ui.html("", sanitize=False).classes("pf-qr")
        line = ui.label("").classes("pf-small")

        def show(name: str) -> None:
            address = access.phone_address(name)
            picture.set_content(segno.make(address, error="m").svg_inline(scale=6, border=3, light="#fff"))
            line.set_text(f"http://{name}:{access.port}/phone with a token that opens this page only")

        def allow(on: bool) -> None:
            studio.phone_may_record = on

        ui.select(access.network_names, value=access.network_names[0], label="Address", on_change=lambda event: show(event.value))
        ui.switch("The phone may start and stop recordings", value=studio.phone_may_record,
                  on_change=lambda event: allow(bool(event.value)))  # fmt: skip
        show(access.network_names[0])


def title(text: str, about: str = "") -> None:
    """The heading of a page and one line on what it is for."""
    with ui.column().classes("pf-title"):
        ui.label(text).classes("pf-h1").props('role="heading" aria-level="1"')
        if about:
            ui.label(about).classes("pf-about")


@contextmanager
def card(heading: str = "", *, classes: str = "") -> Iterator[ui.row]:
    """A panel; gives the row of its heading, for buttons."""
    with ui.card().classes(f"pf-card {classes}").props("flat bordered"):
        head = ui.row().classes("pf-card-head")
        with head:
            if heading:
                ui.label(heading).classes("pf-h2").props('role="heading" aria-level="2"')
        yield head


def state_of(report: Report) -> tuple[str, str]:
    """Light and word of a job; a study of which trials failed is not good."""
    failed = report.result.get("failed")
    if report.state == "done" and failed:
        return "doubt", f"{len(failed)} of {report.result['trials']} failed"
    return {"done": "good", "failed": "bad", "lost": "bad", "cancelled": "off"}.get(report.state, "doubt"), report.state


def light(state: str, text: str) -> ui.row:
    """A light with its word: ``good``, ``bad``, ``doubt`` or ``off``; colour is never the only sign."""
    icon = {"good": "check_circle", "bad": "error", "doubt": "warning", "off": "radio_button_unchecked"}[state]
    with ui.row().classes(f"pf-light pf-{state}") as row:
        ui.icon(icon)
        ui.label(text)
    return row


def refused(error: Exception) -> None:
    """Show one line of what could not be done."""
    ui.notify(str(error), type="negative", multi_line=True, close_button="Close", timeout=0)


def words(name: str) -> str:
    """``left_knee flexion`` as people read it."""
    return name.replace("_", " ")


def job_line(studio: Studio, job: Job) -> None:
    """One job: its title, how far it is, its newest news or its error, and a button to cancel."""
    report = studio.jobs.report(job.id)
    with ui.column().classes("pf-job"):
        with ui.row().classes("pf-job-head"):
            light(*state_of(report))
            ui.link(job.title, job.page).classes("pf-job-title")
            ui.space()
            if not report.ended:
                ui.button(icon="close", on_click=lambda: studio.jobs.cancel(job.id)).props('flat round dense aria-label="Cancel"')
        if not report.ended:
            fraction = report.fraction
            ui.linear_progress(fraction or 0.0, show_value=False).props("indeterminate" if fraction is None else "")
        done = f"{report.stage} {report.done}" + (f" of {report.total}" if report.total else "")
        line = report.error or done * (bool(report.stage) and not report.ended)
        if line:
            ui.label(line).classes("pf-small")


def _nav_link(page: StudioPage, here: StudioPage) -> None:
    with ui.link(target=page.path).classes("pf-nav-link" + (" pf-here" if page is here else "")) as link:
        ui.icon(page.icon)
        ui.label(page.title)
    if page is here:
        link.props('aria-current="page"')


def _jobs_menu(studio: Studio) -> None:
    shown: list[object] = []
    with ui.button(icon="bolt", color=None).props('flat round dense aria-label="Jobs"').classes("pf-jobs-button") as button:
        badge = ui.badge("").props("floating color=accent")
        with ui.menu().classes("pf-jobs"):
            lines = ui.column().classes("pf-jobs-lines")

    def refresh() -> None:
        # sessions have pages of their own, but none may run unseen: where there are two, a page shows one
        jobs = [job for job in studio.jobs.all() if job.work not in (LIVE, WATCH) or not studio.jobs.report(job.id).ended]
        jobs = jobs[:_MOST_JOBS]
        state: list[object] = [(job.id, studio.jobs.report(job.id).without_time) for job in jobs]
        if state == shown:
            return
        shown[:] = state
        running = sum(not studio.jobs.report(job.id).ended for job in jobs)
        badge.set_text(str(running))
        badge.set_visibility(running > 0)
        lines.clear()
        with lines:
            for job in jobs:
                job_line(studio, job)
            if not jobs:
                ui.label("No work has been started in this workspace.").classes("pf-small")

    badge.set_visibility(False)
    button.tooltip("Jobs")
    ui.timer(_POLL_S, refresh)


_LOGO = (
    '<svg viewBox="0 0 32 32" width="28" height="28" aria-hidden="true"><g fill="none" stroke="currentColor" stroke-width="2.4" '
    'stroke-linecap="round"><path d="M16 11v8M16 19l-5 8M16 19l5 8M9 15l7-2 7 2"/></g>'
    '<circle cx="16" cy="6.5" r="3.2" fill="currentColor"/>'
    '<g fill="#ffb300"><circle cx="4" cy="5" r="2"/><circle cx="28" cy="5" r="2"/><circle cx="28" cy="20" r="2"/></g></svg>'
)
