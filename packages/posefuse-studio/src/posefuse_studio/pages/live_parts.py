"""Panels of the live page: health of a camera, recording, people, outputs."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from nicegui import ui

from posefuse.core import InputError
from posefuse.outputs.drawing import person_rgb
from posefuse_studio.shell import card, light, refused
from posefuse_studio.state import Studio
from posefuse_studio.workspace import check_name

_MOST_ROWS = 8
Refresh = Callable[[Mapping[str, Any]], None]

# what can be switched on: plug-in, words, option of the address, its usual value
_OUTPUTS = (
    ("ros2", "ROS 2", "", ""),
    ("osc", "OSC (Blender, Unity, TouchDesigner)", "to", "127.0.0.1:9000"),
    ("lsl", "Lab Streaming Layer", "", ""),
    ("json", "JSON over UDP", "to", "127.0.0.1:9001"),
)


def health_line(camera: str) -> Refresh:
    """Under a tile: state and rate of a camera; why, where it is not well."""
    with ui.row().classes("pf-tile-foot"):
        state = ui.row().classes("pf-light-place")
        figures = ui.label("").classes("pf-small")
    why = ui.label("").classes("pf-small")
    shown: list[Any] = []

    def refresh(status: Mapping[str, Any]) -> None:
        one = status["cameras"].get(camera)
        if one is None:
            return
        if shown != [one["state"]]:
            shown[:] = [one["state"]]
            state.clear()
            with state:
                light("good" if one["state"] == "ok" else "bad", camera if one["state"] == "ok" else f"{camera}: {one['state']}")
        dropped = f", {one['replaced']:.0f} dropped" if one.get("replaced") else ""
        figures.set_text(f"{one['rate_hz']:.0f}/s{dropped}")
        why.set_text(one["text"])
        why.set_visibility(bool(one["text"]))

    return refresh


def record_card(studio: Studio) -> Refresh:
    """Begin and end a recording."""
    with card("Record"):
        with ui.row().classes("items-center gap-4") as choice:
            name = ui.input("Name", value=time.strftime("%Y-%m-%d trial")).props("dense").classes("w-44")
            poses = ui.checkbox("2D and poses (.mcap)", value=True).props("dense")
            videos = ui.checkbox("Videos", value=True).props("dense")

        def begin() -> None:
            if not (poses.value or videos.value):
                ui.notify("Choose what to record: 2D and poses, videos, or both", type="warning")
                return
            try:
                check_name(name.value.strip())
            except InputError as error:
                refused(error)
                return
            studio.live.ask("record", name=name.value.strip(), poses=poses.value, videos=videos.value)

        with ui.row().classes("items-center gap-4"):
            start = ui.button("Record", icon="fiber_manual_record", on_click=begin).props("unelevated no-caps color=negative")
            stop = ui.button("Stop", icon="stop", on_click=lambda: studio.live.ask("stop_recording"))
            stop.props("unelevated no-caps color=negative")
            line = ui.label("").classes("pf-recording")

    def refresh(status: Mapping[str, Any]) -> None:
        recording = status["recording"]
        for element, shown in ((choice, not recording), (start, not recording), (stop, bool(recording)), (line, bool(recording))):
            element.set_visibility(shown)
        if recording:
            seconds = recording["seconds"]
            line.set_text(f"● {recording['folder']}   {int(seconds // 60)}:{seconds % 60:04.1f}")

    return refresh


def people_card(studio: Studio) -> Refresh:
    """Ids, colours and names; the one whose angles are shown.

    A row stays where its person is lost for a while: what is being typed must not vanish with it.
    """
    with card("People"):
        place = ui.column().classes("gap-2 w-full")
        none_seen = ui.label("No person is seen by two cameras.").classes("pf-small")
    rows: dict[int, tuple[ui.row, ui.button]] = {}

    def refresh(status: Mapping[str, Any]) -> None:
        seen = status["people"]
        for person in seen:
            if person not in rows:
                with place:
                    rows[person] = _person_row(studio, person, status["names"].get(person, ""))
        for person in [one for one in rows if one not in seen][: max(len(rows) - _MOST_ROWS, 0)]:
            rows.pop(person)[0].delete()
        for person, (row, button) in rows.items():
            row.classes(**{"remove" if person in seen else "add": "pf-absent"})
            button.set_visibility(len(rows) > 1)
            button.props("unelevated" if status["person"] == person else "flat")
            button.props(remove="flat" if status["person"] == person else "unelevated")
        none_seen.set_visibility(not rows)

    return refresh


def _person_row(studio: Studio, person: int, called: str) -> tuple[ui.row, ui.button]:
    red, green, blue = person_rgb(person)
    with ui.row().classes("items-center gap-3 no-wrap w-full") as row:
        ui.element("div").classes("pf-dot").style(f"background:rgb({red},{green},{blue})")
        ui.label(f"id {person}").classes("pf-small")
        name = ui.input("Name", value=called).props(f'dense aria-label="Name of person {person}"').classes("w-36")
        name.on("blur", lambda: studio.live.ask("name", person=person, text=name.value or ""))
        name.on("keydown.enter", lambda: studio.live.ask("name", person=person, text=name.value or ""))
        button = ui.button("Angles", on_click=lambda: studio.live.ask("person", person=person)).props("dense no-caps size=sm")
    return row, button


def outputs_card(studio: Studio) -> Refresh:
    """Outputs, each switched on and off while the session runs."""
    lines: dict[str, tuple[ui.switch, ui.label]] = {}
    with card("Send to"):
        for name, text, option, usual in _OUTPUTS:
            with ui.column().classes("gap-0 w-full"):
                with ui.row().classes("items-center gap-3 w-full no-wrap"):
                    switch = ui.switch(text)
                    if option:
                        where = ui.input("Address", value=usual).props("dense").classes("w-36")
                        switch.on("update:model-value", _switcher(studio, name, switch, where))
                    else:
                        switch.on("update:model-value", _switcher(studio, name, switch, None))
                lines[name] = switch, ui.label("").classes("pf-small")

    def refresh(status: Mapping[str, Any]) -> None:
        for name, (switch, label) in lines.items():
            on, output = name in status["wanted"], status["outputs"].get(name)
            if switch.value != on:
                switch.set_value(on)
            text = "" if output is None else f"{output['state']}: {output['text'] or output['where']}" * (output["state"] != "ok")
            label.set_text(text or (f"{output['taken']} messages to {output['where'] or 'the network'}" if output and on else ""))
            label.set_visibility(bool(label.text))

    return refresh


def _switcher(studio: Studio, name: str, switch: ui.switch, where: ui.input | None) -> Callable[[], None]:
    def switched() -> None:
        options: dict[str, Any] = {} if where is None else {"to": [where.value]}
        studio.live.ask("output", name=name, options=options if switch.value else None)

    return switched
