"""Phone: the session to look at, read-only; with the button that records where the owner allows it."""

from __future__ import annotations

import time

from nicegui import ui

from posefuse_studio.jobs import LIVE
from posefuse_studio.scene import RigScene
from posefuse_studio.session import SessionStatus
from posefuse_studio.shell import apply_style, camera_tiles, light, redrawn
from posefuse_studio.state import Studio


def build(studio: Studio) -> None:
    """Place the page; it has no link to any other."""
    apply_style()
    live = studio.live
    with ui.column().classes("pf-page pf-phone").props('role="main"'):
        with ui.row().classes("items-center w-full no-wrap"):
            ui.label("posefuse").classes("pf-h1")
            ui.space()
            redrawn(lambda: _word(live.status), lambda word: light(*word), classes="")
        redrawn(lambda: list(live.status.cameras), lambda cameras: _session(studio) if cameras else None, classes="w-full gap-3")


def _word(status: SessionStatus) -> tuple[str, str]:
    if not status.cameras:
        return "off", "no session runs"
    faulty = [name for name, one in status.cameras.items() if one.light == "bad"]
    if status.recording:
        return ("bad" if faulty else "good"), f"recording {status.seconds:.0f} s"
    return ("bad", f"look at {', '.join(faulty)}") if faulty else ("good", f"people: {len(status.people)}")


def _session(studio: Studio) -> None:
    with ui.element("div").classes("pf-stage"):
        RigScene(LIVE, ellipsoids=False)
    record = ui.button(on_click=lambda: record_or_stop(studio)).props("unelevated size=lg color=negative").classes("w-full")
    record.bind_text_from(studio.live, "status", lambda now: "Stop recording" if now.recording else "Record")
    record.bind_visibility_from(studio.live, "status", lambda _: studio.phone_may_record)
    camera_tiles(studio.live, LIVE)


def record_or_stop(studio: Studio) -> None:
    """Begin a recording, or end the one that runs; nothing where the owner does not allow it.

    A hidden button is no lock: a phone can send a click for it all the same, so that it is asked here, too.
    """
    if not studio.phone_may_record:
        return
    if studio.live.status.recording:
        studio.live.ask("stop_recording")
    else:
        studio.live.ask("record", name=time.strftime("%Y-%m-%d trial"), poses=True, videos=True)
