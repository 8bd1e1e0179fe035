"""Live: poses while they happen; and the same session on a phone, read-only."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from nicegui import ui

from posefuse.core import InputError
from posefuse_studio.jobs import LIVE
from posefuse_studio.scene import CameraTile, RigScene, ValuePlot, first_angles
from posefuse_studio.session import SessionStatus
from posefuse_studio.setups import DEMO, setups
from posefuse_studio.shell import (
    apply_style,
    camera_tiles,
    card,
    dialog,
    job_lines,
    light,
    network_field,
    redrawn,
    refused,
    small,
    title,
    words,
)
from posefuse_studio.state import Studio
from posefuse_studio.workspace import check_name

_PARTS = {"skeletons": "Skeleton", "ellipsoids": "Uncertainty", "trails": "Trails", "cameras": "Cameras"}
# what can be switched on: plug-in, words, usual address
_OUTPUTS = (
    ("ros2", "ROS 2", ""),
    ("osc", "OSC (Blender, Unity, TouchDesigner)", "127.0.0.1:9000"),
    ("lsl", "Lab Streaming Layer", ""),
    ("json", "JSON over UDP", "127.0.0.1:9001"),
)


def build(studio: Studio) -> None:
    """Place the page."""
    title("Live", "People in 3D while they move. The session runs on its own: this page may be closed and opened again.")
    live = studio.live

    def draw(state: tuple[str, list[str]]) -> None:
        job, cameras = state
        if cameras:
            _session(studio)
        elif job:
            _starting(studio, job)
        else:
            _start(studio)

    redrawn(lambda: (live.job.id if live.job else "", list(live.status.cameras)), draw, classes="pf-column w-full")


def _start(studio: Studio) -> None:
    choices = [one.name for one in setups(studio.workspace) if one.rig or one.name == DEMO]
    with card("Start a session"):
        with ui.row().classes("items-end gap-4"):
            setup = ui.select(choices, value=choices[-1], label="Cameras").classes("w-56")
            people = ui.number("People", value=1, min=1, precision=0).classes("pf-number")
            network = network_field("chosen by the speed of this machine")

        def start() -> None:
            settings = {"track.max_people": int(people.value or 1)}
            arguments = {"setup": setup.value, "networks": network.value, "settings": settings}
            studio.jobs.start(LIVE, f"Live session of {setup.value}", arguments)

        with ui.row().classes("items-center gap-3"):
            ui.button("Start", icon="play_arrow", on_click=start).props("unelevated size=lg")
            small("Cameras that are not calibrated are not in the list: see Calibrate.")
    if studio.jobs.all(LIVE):
        with card("The last session"):
            job_lines(studio, lambda job, _: job.work == LIVE, most=1)


def _starting(studio: Studio, session: str) -> None:
    with card():
        with ui.row().classes("items-center gap-4"):
            ui.spinner(size="lg")
            ui.label("Starting").classes("pf-next")
        job_lines(studio, lambda job, _: job.id == session)


def _session(studio: Studio) -> None:
    with ui.element("div").classes("pf-split"):
        with ui.element("div").classes("pf-column"):
            _scene_card()
            _tiles_card(studio)
        with ui.element("div").classes("pf-column"):
            _figures_card(studio)
            _record_card(studio)
            _angles_card(studio)
            _outputs_card(studio)
            _news_card(studio)


def _scene_card() -> None:
    with card("3D") as head, ui.element("div").classes("pf-stage"):
        scene = RigScene(LIVE, ellipsoids=True, trails=True)
        with ui.row().classes("pf-stage-views"):
            scene.view_buttons()
    with head, ui.row().classes("gap-3"):
        for name, text in _PARTS.items():
            ui.checkbox(text, value=True, on_change=lambda event, name=name: scene.show(**{name: event.value})).props("dense")


def _tiles_card(studio: Studio) -> None:
    with card("Cameras") as head:
        tiles = camera_tiles(studio.live, LIVE)
    with head:
        CameraTile.overlay_switch(tiles)


def _figures_card(studio: Studio) -> None:
    def figure(about: str, text: Callable[[SessionStatus], str]) -> None:
        with ui.column().classes("gap-0"):
            ui.label().bind_text_from(studio.live, "status", text).classes("pf-figure")
            small(about)

    def cameras(now: SessionStatus) -> str:
        return f"{sum(one.light == 'good' for one in now.cameras.values())} of {len(now.cameras)}"

    with card("Session") as head, ui.row().classes("pf-figures"):
        figure("latency, 95 %", lambda now: "–" if now.latency_p95_ms is None else f"{now.latency_p95_ms:.0f} ms")
        figure("cameras working", cameras)
        figure("people", lambda now: str(len(now.people)))
    with head:
        ui.button("End session", icon="stop", on_click=lambda: _ask_end(studio)).props("outline dense color=negative")


def _ask_end(studio: Studio) -> None:
    job = studio.live.job
    # the session that was shown when the button was pressed, not one that has taken its place
    if job is not None:
        with dialog("End the session for everyone?", {"End it": partial(studio.jobs.cancel, job.id)}):
            ui.label("A recording is finished first.")


def _record_card(studio: Studio) -> None:
    live = studio.live

    def begin() -> None:
        check_name(name.value.strip())
        if not (poses.value or videos.value):
            raise InputError("Choose what to record: 2D and poses, videos, or both")
        live.ask("record", name=name.value.strip(), poses=poses.value, videos=videos.value)

    def recorded(now: SessionStatus) -> str:
        return f"● {now.recording}   {int(now.seconds // 60)}:{now.seconds % 60:04.1f}"

    with card("Record"):
        with ui.column().bind_visibility_from(live, "status", lambda now: not now.recording):
            with ui.row().classes("items-center gap-4"):
                name = ui.input("Name", value=time.strftime("%Y-%m-%d trial")).props("dense").classes("w-44")
                poses = ui.checkbox("2D and poses (.mcap)", value=True).props("dense")
                videos = ui.checkbox("Videos", value=True).props("dense")
            ui.button("Record", icon="fiber_manual_record", on_click=begin).props("unelevated color=negative")
        with ui.row().classes("items-center gap-4").bind_visibility_from(live, "status", lambda now: bool(now.recording)):
            stop = ui.button("Stop", icon="stop", on_click=lambda: live.ask("stop_recording"))
            stop.props("unelevated color=negative")
            ui.label().bind_text_from(live, "status", recorded).classes("pf-recording")
        redrawn(lambda: recording_fault(live.status), lambda fault: light("bad", fault) if fault else None)


def recording_fault(status: SessionStatus) -> str:
    """Why the poses of the recording that runs are not written now; empty where they are, or are not wanted."""
    record = status.outputs.get("record") if status.recording else None
    return "" if record is None or record.state == "ok" else f"not recorded, {record.state}: {record.text}"


def _angles_card(studio: Studio) -> None:
    live = studio.live
    names = live.status.plots
    chosen = first_angles(names)

    def choose_person(seen: list[int]) -> None:
        if len(seen) > 1:
            now = live.status.person if live.status.person in seen else seen[0]
            options = {person: f"person {person}" for person in seen}
            ui.select(options, value=now, label="Of", on_change=lambda event: live.ask("person", person=event.value))

    with card("Joint angles") as head:
        with head:
            redrawn(lambda: live.status.people, choose_person, classes="")
        choice = ui.select({name: words(name) for name in names}, value=chosen, multiple=True)
        choice.props("dense use-chips").classes("w-full")
        plot = ValuePlot(LIVE, [names.index(name) for name in chosen], chosen)
        if not names:
            small("No angles: the network does not mark enough of the body.")
    choice.on_value_change(lambda event: plot.choose([names.index(one) for one in event.value], event.value))


def _outputs_card(studio: Studio) -> None:
    """Outputs, each switched on and off while the session runs."""
    with card("Send to"):
        for name, text, usual in _OUTPUTS:
            with ui.column().classes("gap-0 w-full"), ui.row().classes("items-center gap-3 w-full no-wrap"):
                _output_switch(studio, name, text, usual)


def _output_switch(studio: Studio, name: str, text: str, usual: str) -> None:
    live = studio.live

    def switched() -> None:
        options = {"to": [where.value]} if usual else {}
        live.ask("output", name=name, options=options if switch.value else None)

    def state(now: SessionStatus) -> str:
        output = now.outputs.get(name)
        if output is None:
            return ""
        if output.state != "ok":
            return f"{output.state}: {output.text or output.where}"
        return f"{output.taken} messages to {output.where or 'the network'}" * (name in now.wanted)

    switch = ui.switch(text).bind_value_from(live, "status", lambda now: name in now.wanted)
    switch.on("update:model-value", switched)
    if usual:
        where = ui.input("Address", value=usual).props("dense").classes("w-36")
    small("").bind_text_from(live, "status", state)


def _news_card(studio: Studio) -> None:
    shown = set(studio.live.status.refused)

    def draw(state: tuple[list[str], list[str]]) -> None:
        no, news = state
        # the card may be below the window
        for line in [one for one in no if one not in shown]:
            refused(line.partition(" ")[2])
        shown.update(no)
        for line in no[-3:]:
            light("bad", line.partition(" ")[2])
        for line in reversed(news):
            small(line)
        if not (no or news):
            small("Nothing so far.")

    with card("What happened"):
        redrawn(lambda: (studio.live.status.refused, studio.live.status.news[-8:]), draw, classes="gap-1 pf-news")


def build_phone(studio: Studio) -> None:
    """Place the page of a phone, which has no link to any other; the button that records is there where the owner allows it."""
    apply_style()
    live = studio.live
    with ui.column().classes("pf-page pf-phone").props('role="main"'):
        with ui.row().classes("items-center w-full no-wrap"):
            ui.label("posefuse").classes("pf-h1")
            ui.space()
            redrawn(lambda: _session_light(live.status), lambda word: light(*word), classes="")
        redrawn(
            lambda: list(live.status.cameras), lambda cameras: _phone_session(studio) if cameras else None, classes="w-full gap-3"
        )


def _session_light(status: SessionStatus) -> tuple[str, str]:
    if not status.cameras:
        return "off", "no session runs"
    faulty = [name for name, one in status.cameras.items() if one.light == "bad"]
    if fault := recording_fault(status):
        return "bad", fault
    if status.recording:
        return ("bad" if faulty else "good"), f"recording {status.seconds:.0f} s"
    return ("bad", f"look at {', '.join(faulty)}") if faulty else ("good", f"people: {len(status.people)}")


def _phone_session(studio: Studio) -> None:
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
