"""What every page has: one style, the navigation, the jobs that run; and what pages are put together from."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlencode

import segno
from nicegui import ui

from posefuse.core import PosefuseError
from posefuse.detection import named_networks
from posefuse.foundation.summary import Block, Cell, Facts, Heading, Note, Table
from posefuse_studio.access import is_loopback
from posefuse_studio.jobs import LIVE, WATCH, Job, Report
from posefuse_studio.pages import PAGES, StudioPage
from posefuse_studio.scene import CameraTile
from posefuse_studio.session import CameraStatus
from posefuse_studio.state import LiveLink, Studio
from posefuse_studio.workspace import recording_place

T = TypeVar("T")
_STYLE = Path(__file__).with_name("style.css")
_REDRAW_S = 0.7
# older work is in the jobs menu
_RECENT_S = 3600.0
_MOST_JOBS, _MOST_IN_MENU, _SHOWN_NEWS = 4, 8, 2
REFUSALS = (PosefuseError, OSError)
"""What cannot be done: a page shows it in one line, wherever it was raised."""
_BUG = "this is a bug of the studio; see its terminal ({})"
LIGHTS = {"good": "check_circle", "bad": "error", "doubt": "warning", "busy": "pending", "off": "radio_button_unchecked"}


@contextmanager
def shell(studio: Studio, here: StudioPage) -> Iterator[None]:
    """The frame of a page; its own elements go into the block."""
    dark = apply_style()
    named = studio.workspace.in_names
    ui.on_exception(lambda one: refused(named(str(one)) if isinstance(one, REFUSALS) else _BUG.format(type(one).__name__)))
    with ui.header(elevated=False).classes("pf-header"):
        with ui.link(target="/").classes("pf-brand"):
            ui.html(_LOGO, sanitize=False)
            ui.label("posefuse studio")
        with ui.row().classes("pf-nav").props('role="navigation" aria-label="Pages"'):
            _navigation(here)
        ui.space()
        icon_button("qr_code_2", "Phone", lambda: _phone(studio), color=None).tooltip("On a phone")
        _jobs_menu(studio)
        turn = icon_button("contrast", "Light or dark", lambda: dark.set_value(not dark.value), color=None)
        turn.tooltip("Light or dark")
    with ui.footer().classes("pf-bottom").props('role="navigation" aria-label="Pages"'):
        _navigation(here)
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
            small("The studio is reached from this machine only. To let a phone in the same network look, start it again with")
            ui.code(f"posefuse studio {studio.workspace.root} --host 0.0.0.0", language="bash")
            return
        code, line = ui.html("", sanitize=False).classes("pf-qr"), small("")

        def show(name: str) -> None:
            address = access.phone_address(name)
            code.set_content(segno.make(address, error="m").svg_inline(scale=6, border=3, light="#fff"))
            line.set_text(f"http://{name}:{access.port}/phone with a token that opens this page only")

        ui.select(access.network_names, value=access.network_names[0], label="Address", on_change=lambda event: show(event.value))
        ui.switch("The phone may start and stop recordings").bind_value(studio, "phone_may_record")
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
                ui.space()
        yield head


def small(text: str) -> ui.label:
    """A line that explains."""
    return ui.label(text).classes("pf-small")


def icon_button(icon: str, label: str, act: Callable[..., object], color: str | None = "primary") -> ui.button:
    """A button without words; `label` is what it is called."""
    button = ui.button(icon=icon, color=color, on_click=act).props("flat round dense")
    # not as text of several properties: a file name may have quotes
    button.props["aria-label"] = label
    return button


def light(state: str, text: str) -> ui.row:
    """A light of `LIGHTS` with its word; colour is never the only sign."""
    with ui.row().classes(f"pf-light pf-{state}") as row:
        ui.icon(LIGHTS[state])
        ui.label(text)
    return row


def refused(text: str) -> None:
    """Show one line of what could not be done."""
    ui.notify(text, type="negative", multi_line=True, close_button="Close", timeout=0)


@contextmanager
def dialog(heading: str, actions: Mapping[str, Callable[[], object]]) -> Iterator[None]:
    """Ask for what the block places; a button for each action, the first one the main one, closes it unless that is refused."""
    # of the page, not of what is drawn again where the button was pressed
    with ui.context.client.content, ui.dialog(value=True) as shown, card(heading):

        def done(act: Callable[[], object]) -> None:
            act()
            shown.close()

        place = ui.column().classes("gap-3")
        with ui.row().classes("w-full justify-end"):
            ui.button("Cancel", on_click=shown.close).props("flat")
            for number, (name, act) in reversed([*enumerate(actions.items())]):
                ui.button(name, on_click=partial(done, act)).props("flat" if number else "unelevated")
        with place:
            yield


def redrawn(state: Callable[[], T], draw: Callable[[T], object], *, classes: str = "w-full") -> Callable[[], None]:
    """A place that is drawn again when its state has changed, and only then: what is replaced while it is pressed does nothing.

    Returns:
        Looks at once.
    """
    place = ui.column().classes(classes)
    drawn: list[T] = []

    def look() -> None:
        now = state()
        if drawn != [now]:
            drawn[:] = [now]
            place.clear()
            with place:
                draw(now)

    look()
    ui.timer(_REDRAW_S, look)
    return look


def words(name: str) -> str:
    """``left_knee flexion`` as people read it."""
    return name.replace("_", " ")


def file_address(name: str) -> str:
    """Where a file of the workspace is fetched."""
    return f"/studio/file?{urlencode({'name': name})}"


def recording_address(name: str) -> str:
    """The page of a recording."""
    return f"/recordings?{urlencode({'open': name})}"


def state_of(report: Report) -> tuple[str, str]:
    """Light and word of a job; a calibration that was refused, and work of which trials or files failed, are not good."""
    if report.result.get("passed") is False:
        return "bad", "refused"
    if report.state == "done" and (failed := report.result.get("failed")):
        return "doubt", f"{len(failed)} failed"
    return {"done": "good", "failed": "bad", "lost": "bad", "cancelled": "off"}.get(report.state, "busy"), report.state


def page_of(job: Job) -> str:
    """Where the result of a job is shown."""
    if job.work == WATCH:
        return "/calibrate" if job.arguments.get("folder") else "/"
    return {LIVE: "/live", "calibrate": "/calibrate", "simulate_walk": "/simulate"}.get(job.work, "/recordings")


def job_lines(studio: Studio, wanted: Callable[[Job, Report], bool], *, most: int = _MOST_JOBS, otherwise: str = "") -> None:
    """The newest jobs that are wanted, as they are now, each with what it has made; `otherwise`: words where there is none."""

    def newest() -> list[tuple[Job, Report]]:
        found = ((job, studio.jobs.report(job.id).without_time) for job in studio.jobs.all())
        return list(islice((one for one in found if wanted(*one)), most))

    def draw(found: list[tuple[Job, Report]]) -> None:
        for job, report in found:
            with ui.column().classes("pf-job"):
                _job(studio, job, report)
        if otherwise and not found:
            small(otherwise)

    redrawn(newest, draw, classes="pf-job-lines")


def recent(*works: str, about: str = "") -> Callable[[Job, Report], bool]:
    """Wanted are jobs of an hour, of these kinds of work; `about`: only those that have this value as an argument."""
    return lambda job, _: (
        job.work in works and abs(time.time() - job.begun_s) < _RECENT_S and (not about or about in job.arguments.values())
    )


def _job(studio: Studio, job: Job, report: Report) -> None:
    """Its title, how far it is, its newest news or its error, what it has made, and a button to cancel."""
    with ui.row().classes("pf-job-head"):
        light(*state_of(report))
        ui.link(job.title, page_of(job)).classes("pf-job-title")
        ui.space()
        if not report.ended:
            icon_button("close", "Cancel", lambda: studio.jobs.cancel(job.id))
    if not report.ended:
        fraction = report.fraction
        ui.linear_progress(fraction or 0.0, show_value=False).props("indeterminate" if fraction is None else "")
        if report.stage:
            small(f"{report.stage} {report.done}" + (f" of {report.total}" if report.total else ""))
    for line in [report.error] if report.error else report.news[-_SHOWN_NEWS:]:
        small(line)
    with ui.row():
        if "page" in report.result:
            ui.link("Open the page", file_address(report.result["page"]), new_tab=True)
        for name in report.result.get("recordings", ()):
            ui.link(f"Open {recording_place(name).name}", recording_address(name))
        for name in report.result.get("files", ()):
            ui.link(name.split("/")[-1], file_address(name)).props("download")


def _navigation(here: StudioPage) -> None:
    for page in PAGES:
        with ui.link(target=page.path).classes("pf-nav-link" + (" pf-here" if page is here else "")) as link:
            ui.icon(page.icon)
            ui.label(page.title)
        if page is here:
            link.props('aria-current="page"')


def _jobs_menu(studio: Studio) -> None:
    def running(count: int) -> None:
        if count:
            ui.badge(str(count)).props("floating color=accent")

    with icon_button("bolt", "Jobs", lambda: None, color=None).classes("pf-jobs-button").tooltip("Jobs"):
        redrawn(lambda: len(studio.jobs.running()), running, classes="")
        with ui.menu().classes("pf-jobs"):
            # sessions have pages of their own, but none may run unseen: where there are two, a page shows one
            job_lines(
                studio,
                lambda job, report: job.work not in (LIVE, WATCH) or not report.ended,
                most=_MOST_IN_MENU,
                otherwise="No work has been started in this workspace.",
            )


_LOGO = (
    '<svg viewBox="0 0 32 32" width="28" height="28" aria-hidden="true"><g fill="none" stroke="currentColor" stroke-width="2.4" '
    'stroke-linecap="round"><path d="M16 11v8M16 19l-5 8M16 19l5 8M9 15l7-2 7 2"/></g>'
    '<circle cx="16" cy="6.5" r="3.2" fill="currentColor"/>'
    '<g fill="#ffb300"><circle cx="4" cy="5" r="2"/><circle cx="28" cy="5" r="2"/><circle cx="28" cy="20" r="2"/></g></svg>'
)


def camera_tiles(link: LiveLink, stream: str, *, overlay: bool = True, classes: str = "pf-grid") -> list[CameraTile]:
    """A tile for each camera of a session; `stream`: what they draw."""
    tiles = []
    with ui.element("div").classes(classes):
        for number, (name, one) in enumerate(link.status.cameras.items()):
            width, height = one.size_wh or (4, 3)
            with ui.column().classes("pf-tile-box"):
                tiles.append(CameraTile(stream, number, aspect=width / height, name=name, overlay=overlay))
                _foot(link, name)
    return tiles


def _foot(link: LiveLink, name: str) -> None:
    def draw(now: CameraStatus | None) -> None:
        # none for a moment, when the session has ended
        if now is not None:
            with ui.row().classes("pf-tile-foot"):
                light(now.light, name if now.light != "bad" else f"{name}: {now.state}")
                small(now.figures)
            if now.text:
                small(now.text)

    redrawn(lambda: link.status.cameras.get(name), draw, classes="w-full gap-1")


def network_field(usual: str) -> ui.select:
    """Choose a 2D network by name; `usual`: what the empty name stands for. One that is not there is refused with what to do."""
    names = {"": usual, **{name: f"{name}: {about}" for name, about in named_networks().items()}}
    return ui.select(names, value="", label="Network").classes("w-80")


def show_summary(blocks: Iterable[Block]) -> None:
    """Place them."""
    for block in blocks:
        match block:
            case Heading():
                ui.label(block.text).classes("pf-h2")
                if block.note:
                    small(block.note)
            case Note():
                light("doubt", block.text) if block.warning else small(block.text)
            case Facts():
                _grid([(Cell(name), Cell(value)) for name, value in block.shown])
            case Table():
                _grid([[Cell(name) for name in block.columns], *block.shown])


def _grid(rows: Sequence[Sequence[Cell]]) -> None:
    columns = f"repeat({max(map(len, rows), default=1) - 1}, auto) 1fr"
    with ui.element("div").classes("pf-summary").style(f"grid-template-columns: {columns}"):
        for row in rows:
            for cell in row:
                small(str(cell.value)).classes(f"pf-tone-{cell.tone or 'none'}")
