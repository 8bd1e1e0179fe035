"""Phone: the session to look at, read-only; with the button that records where the owner allows it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from nicegui import ui

from posefuse_studio.pages.live_parts import health_line
from posefuse_studio.scene.view import CameraTile, RigScene
from posefuse_studio.session_messages import LIVE
from posefuse_studio.shell import apply_style, light
from posefuse_studio.state import Studio

_REFRESH_S = 0.7


def build(studio: Studio) -> None:
    """Place the page; it has no link to any other."""
    apply_style()
    with ui.column().classes("pf-page pf-phone").props('role="main"'):
        with ui.row().classes("items-center w-full no-wrap"):
            ui.label("posefuse").classes("pf-h1")
            ui.space()
            state = ui.row()
        place = ui.column().classes("w-full gap-3")
    shown: list[Any] = [None]
    refreshers: list[Any] = []

    def refresh() -> None:
        status = studio.live.status
        cameras = tuple(status.get("sizes", {}))
        if shown[0] != cameras:
            shown[0] = cameras
            refreshers.clear()
            place.clear()
            with place:
                refreshers.extend(_session(studio, status) if cameras else [])
        state.clear()
        with state:
            light(*_word(status))
        for one in refreshers:
            one(status)

    refresh()
    ui.timer(_REFRESH_S, refresh)


def _word(status: Mapping[str, Any]) -> tuple[str, str]:
    if not status.get("cameras"):
        return "off", "no session runs"
    faulty = [name for name, one in status["cameras"].items() if one["state"] != "ok"]
    if recording := status["recording"]:
        return ("bad" if faulty else "good"), f"recording {recording['seconds']:.0f} s"
    return ("bad", f"look at {', '.join(faulty)}") if faulty else ("good", f"people: {len(status['people'])}")


def _session(studio: Studio, status: Mapping[str, Any]) -> list[Any]:
    refreshers = []
    with ui.element("div").classes("pf-stage"):
        RigScene(LIVE, ellipsoids=False)
    record = ui.button("Record", on_click=lambda: record_or_stop(studio)).classes("w-full")
    record.props("unelevated size=lg color=negative no-caps")

    def refresh(now: Mapping[str, Any]) -> None:
        record.set_visibility(studio.phone_may_record)
        record.set_text("Stop recording" if now.get("recording") else "Record")

    with ui.element("div").classes("pf-grid"):
        for number, (name, (width, height)) in enumerate(status["sizes"].items()):
            with ui.column().classes("pf-tile-box"):
                CameraTile(LIVE, number, aspect=width / height, name=name)
                refreshers.append(health_line(name))
    return [refresh, *refreshers]


def record_or_stop(studio: Studio) -> None:
    """Begin a recording, or end the one that runs; nothing where the owner does not allow it.

    A hidden button is no lock: a phone can send a click for it all the same, so that it is asked here, too.
    """
    if not studio.phone_may_record:
        return
    if studio.live.status.get("recording"):
        studio.live.ask("stop_recording")
    else:
        studio.live.ask("record", name=time.strftime("%Y-%m-%d trial"), poses=True, videos=True)
