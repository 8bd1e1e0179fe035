"""Live: poses while they happen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from nicegui import ui

from posefuse.core import InputError, PosefuseError
from posefuse_studio.job_cards import result_links
from posefuse_studio.jobs import Jobs
from posefuse_studio.pages.live_parts import health_line, outputs_card, people_card, record_card
from posefuse_studio.scene.view import VIEWS, CameraTile, RigScene, ValuePlot
from posefuse_studio.session_messages import LIVE
from posefuse_studio.setups import DEMO, setups
from posefuse_studio.shell import card, job_line, light, refused, title, words
from posefuse_studio.state import Studio

_REFRESH_S = 0.5
_NETWORKS = {"": "chosen by the speed of this machine", "blazepose_lite": "lite", "blazepose_full": "full",
             "blazepose_heavy": "heavy", "blazepose_best": "best"}  # fmt: skip
_PLOTTED = ("left_knee flexion", "right_knee flexion")


def build(studio: Studio) -> None:
    """Place the page."""
    title("Live", "People in 3D while they move. The session runs on its own: this page may be closed and opened again.")
    place = ui.column().classes("pf-column w-full")
    shown: list[Any] = [None]

    def refresh() -> None:
        cameras = tuple(studio.live.status.get("sizes", {}))
        state = (studio.live.job and studio.live.job.id, cameras)
        if state == shown[0]:
            return
        shown[0] = state
        place.clear()
        with place:
            if cameras:
                _session(studio)
            elif studio.live.job is not None:
                _starting(studio)
            else:
                _start(studio)

    refresh()
    ui.timer(_REFRESH_S, refresh)


def _start(studio: Studio) -> None:
    choices = [one.name for one in setups(studio.workspace) if one.rig or one.name == DEMO]
    ended = next(iter(studio.jobs.all(LIVE)), None)
    with card("Start a session"):
        with ui.row().classes("items-end gap-4"):
            setup = ui.select(choices, value=choices[-1], label="Cameras").classes("w-56")
            people = ui.number("People", value=1, min=1, max=16, step=1, precision=0).classes("w-24")
            network = ui.select(_NETWORKS, value="", label="Network").classes("w-80")

        def start() -> None:
            arguments = {"setup": setup.value, "people": int(people.value or 1), "networks": network.value}
            try:
                start_session(studio.jobs, f"Live session of {setup.value}", arguments)
            except PosefuseError as error:
                refused(error)

        with ui.row().classes("items-center gap-3"):
            ui.button("Start", icon="play_arrow", on_click=start).props("unelevated size=lg")
            ui.label("Cameras that are not calibrated are not in the list: see Calibrate.").classes("pf-small")
    if ended is not None:
        with card("The last session"):
            job_line(studio, ended)
            result_links(studio.jobs.report(ended.id))


def start_session(jobs: Jobs, title: str, arguments: Mapping[str, Any]) -> None:
    """Start a live session, unless one runs, which the page shows in a moment; cameras that are only looked at are given free.

    Raises:
        InputError: a calibration is being recorded.
    """
    if jobs.running(LIVE):
        return
    jobs.free_cameras()
    jobs.start(LIVE, title, arguments, page="/live")


def _starting(studio: Studio) -> None:
    with card():
        with ui.row().classes("items-center gap-4"):
            ui.spinner(size="lg")
            ui.label("Starting").classes("pf-next")
        news = ui.label("").classes("pf-small")
    job = studio.live.job

    def refresh() -> None:
        if job is not None:
            news.set_text("; ".join(studio.jobs.report(job.id).news[-2:]))

    ui.timer(_REFRESH_S, refresh)


def _session(studio: Studio) -> None:
    sizes: Mapping[str, Any] = studio.live.status["sizes"]
    refreshers: list[Callable[[Mapping[str, Any]], None]] = []
    with ui.element("div").classes("pf-split"):
        with ui.element("div").classes("pf-column"):
            _scene_card()
            _tiles_card(sizes, refreshers)
        with ui.element("div").classes("pf-column"):
            _figures_card(studio, refreshers)
            refreshers.append(record_card(studio))
            _angles_card(studio)
            refreshers.append(people_card(studio))
            refreshers.append(outputs_card(studio))
            _news_card(refreshers)

    def refresh() -> None:
        if status := studio.live.status:
            for one in refreshers:
                one(status)

    refresh()
    ui.timer(_REFRESH_S, refresh)


def _scene_card() -> None:
    with card("3D") as head, ui.element("div").classes("pf-stage"):
        scene = RigScene(LIVE, ellipsoids=True, trails=True)
        with ui.row().classes("pf-stage-views"):
            for where, text in VIEWS.items():
                ui.button(text, on_click=lambda where=where: scene.look(where)).props("flat dense no-caps size=sm")
    with head:
        ui.space()
        with ui.row().classes("gap-3"):
            boxes = {name: ui.checkbox(text, value=True).props("dense") for name, text in _PARTS.items()}
    for name, box in boxes.items():
        box.on_value_change(lambda event, name=name: scene.show(**{name: bool(event.value)}))


_PARTS = {"skeletons": "Skeleton", "ellipsoids": "Uncertainty", "trails": "Trails", "cameras": "Cameras"}


def _tiles_card(sizes: Mapping[str, Any], refreshers: list[Callable[[Mapping[str, Any]], None]]) -> None:
    with card("Cameras") as head, ui.element("div").classes("pf-grid"):
        tiles = []
        for number, (name, (width, height)) in enumerate(sizes.items()):
            with ui.column().classes("pf-tile-box"):
                tiles.append(CameraTile(LIVE, number, aspect=width / height, name=name))
                refreshers.append(health_line(name))
    with head:
        ui.space()
        overlay = ui.checkbox("Keypoints", value=True).props("dense")

    def switch_overlay() -> None:
        for tile in tiles:
            tile.show(bool(overlay.value))

    overlay.on_value_change(switch_overlay)


def _figures_card(studio: Studio, refreshers: list[Callable[[Mapping[str, Any]], None]]) -> None:
    with card("Session") as head, ui.row().classes("pf-figures"):
        latency, cameras, people = (_figure(text) for text in ("latency, 95 %", "cameras working", "people"))
    with head:
        ui.space()
        ui.button("End session", icon="stop", on_click=lambda: _end(studio)).props("outline dense no-caps color=negative")

    def refresh(status: Mapping[str, Any]) -> None:
        states = [one["state"] for one in status["cameras"].values()]
        value = status["latency_p95_ms"]
        latency.set_text(f"{value:.0f} ms" if value == value else "–")
        cameras.set_text(f"{states.count('ok')} of {len(states)}")
        people.set_text(str(len(status["people"])))

    refreshers.append(refresh)


def _figure(about: str) -> ui.label:
    with ui.column().classes("gap-0"):
        value = ui.label("–").classes("pf-figure")
        ui.label(about).classes("pf-small")
    return value


async def _end(studio: Studio) -> None:
    job = studio.live.job
    with ui.dialog() as dialog, ui.card():
        ui.label("End the session for everyone? A recording is finished first.")
        with ui.row().classes("w-full justify-end"):
            ui.button("Keep it", on_click=lambda: dialog.submit(False)).props("flat no-caps")
            ui.button("End it", on_click=lambda: dialog.submit(True)).props("unelevated no-caps color=negative")
    # the session that was shown when the button was pressed, not one that has taken its place
    if await dialog and job is not None:
        studio.jobs.cancel(job.id)


def _angles_card(studio: Studio) -> None:
    names = list(studio.live.status["plots"])
    chosen = [name for name in _PLOTTED if name in names] or names[:2]
    with card("Joint angles"):
        choice = (
            ui.select({name: words(name) for name in names}, value=chosen, multiple=True)
            .props("dense use-chips")
            .classes("w-full")
        )
        plot = ValuePlot(LIVE, [names.index(name) for name in chosen], chosen)
        if not names:
            ui.label("No angles: the network does not mark enough of the body.").classes("pf-small")
    choice.on_value_change(lambda event: plot.choose([names.index(one) for one in event.value], event.value))


def _news_card(refreshers: list[Callable[[Mapping[str, Any]], None]]) -> None:
    with card("What happened"):
        lines = ui.column().classes("gap-1 pf-news")
    shown: list[list[str]] = []

    def refresh(status: Mapping[str, Any]) -> None:
        news, no = list(status["news"][-8:]), list(status["refused"])
        if [news, no] == shown:
            return
        # the card may be below the window
        for line in [one for one in no if one not in shown[1]] if shown else []:
            refused(InputError(line.partition(" ")[2]))
        shown[:] = [news, no]
        lines.clear()
        with lines:
            for line in no[-3:]:
                light("bad", line.partition(" ")[2])
            for line in reversed(news):
                ui.label(line).classes("pf-small")
            if not (no or news):
                ui.label("Nothing so far.").classes("pf-small")

    refreshers.append(refresh)
