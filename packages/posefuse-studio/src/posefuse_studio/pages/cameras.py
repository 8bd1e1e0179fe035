"""Cameras: what there is to see with, under names, saved as presets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from nicegui import ui

from posefuse.core import InputError, PosefuseError
from posefuse_studio.found import Found, found_sources
from posefuse_studio.scene.view import CameraTile
from posefuse_studio.session_messages import WATCH
from posefuse_studio.setups import DEMO, Setup, delete_setup, save_setup, setup_named, setups
from posefuse_studio.shell import card, light, refused, title
from posefuse_studio.state import Studio
from posefuse_studio.workspace import check_name

_REFRESH_S = 0.7
_KINDS = {"rtsp://": "RTSP stream", "http://": "HTTP stream", "usb:": "USB camera", "realsense:": "RealSense", "oak:": "OAK",
          "ros:/": "ROS topic"}  # fmt: skip


def build(studio: Studio) -> None:
    """Place the page."""
    title("Cameras", "Choose what to look through, name it, and see that every image is sharp, bright enough and complete.")
    _Chooser(studio).build()


class _Chooser:
    """The cameras that one visitor puts together."""

    def __init__(self, studio: Studio) -> None:
        self._studio = studio
        self._sources: dict[str, str] = {}
        self._rig = ""
        self._tiles_of: Any = None
        watching = studio.watch.job
        if watching is not None and watching.arguments.get("sources"):
            self._sources = dict(watching.arguments["sources"])

    def build(self) -> None:
        """Place it."""
        with ui.element("div").classes("pf-split"):
            with ui.element("div").classes("pf-column"):
                with card("Your cameras") as head:
                    self._rows = ui.column().classes("w-full gap-2")
                    self._buttons()
                with head:
                    ui.space()
                    self._preset = ui.select([], label="Preset", on_change=lambda event: self._load(event.value)).props("dense")
                    self._preset.classes("w-44")
                with card("Images"):
                    self._tiles = ui.column().classes("w-full")
            with ui.element("div").classes("pf-column"):
                self._found_card()
                self._address_card()
        self._show_rows()
        self._show_presets()
        self._refresh()
        ui.timer(_REFRESH_S, self._refresh)

    def _found_card(self) -> None:
        with card("Found") as head:
            lines = ui.column().classes("w-full gap-1 pf-found")

        async def look() -> None:
            found = await asyncio.to_thread(found_sources, self._studio.workspace)
            lines.clear()
            with lines:
                for one in found:
                    with ui.row().classes("items-center gap-2 no-wrap w-full"):
                        ui.icon(one.icon).classes("text-primary")
                        ui.label(one.text).classes("pf-grow")
                        add = ui.button(icon="add", on_click=lambda one=one: self._add(one)).props("flat dense round")
                        add.props["aria-label"] = f"Add {one.text}"
                if not found:
                    ui.label("No camera on USB, no video and no scene in the workspace.").classes("pf-small")

        with head:
            ui.space()
            ui.button(icon="refresh", on_click=look).props('flat dense round aria-label="Look again"')
        ui.timer(0.1, look, once=True)

    def _address_card(self) -> None:
        with card("By address"):
            ui.label("A network camera, a depth camera, a ROS topic; a phone with an RTSP app works, too.").classes("pf-small")
            with ui.row().classes("items-center gap-2 w-full no-wrap"):
                what = ui.input("e.g. rtsp://192.168.1.20/stream").classes("pf-grow")

                def add() -> None:
                    text = (what.value or "").strip()
                    kind = next((words for start, words in _KINDS.items() if text.startswith(start)), "")
                    if not kind:
                        ui.notify(f"Expected an address that begins with {', '.join(_KINDS)}", type="warning")
                        return
                    self._add(Found(text=text, source=text, name=f"cam{len(self._sources) + 1}", icon="lan"))
                    what.set_value("")

                ui.button("Add", on_click=add).props("outline no-caps")
        with card("Upload videos"):
            ui.upload(multiple=True, auto_upload=True, max_file_size=4 * 2**30, on_upload=self._uploaded).props(
                'accept="video/*" flat bordered label="Press + or drop videos here"'
            )

    async def _uploaded(self, event: Any) -> None:
        try:
            name = await self._studio.workspace.upload("videos", event.file.name, event.file.iterate())
        except PosefuseError as error:
            refused(error)
            return
        self._add(Found(text=name, source=f"video:{name}", name=event.file.name.rpartition(".")[0][:40], icon="movie"))

    def _add(self, one: Found) -> None:
        name, number = one.name.replace(" ", "_"), 1
        while name in self._sources:
            number += 1
            name = f"{one.name}_{number}"
        self._sources[name] = one.source
        self._show_rows()

    def _buttons(self) -> None:
        with ui.row().classes("gap-3 items-center"):
            self._look = ui.button("Show images", icon="visibility", on_click=self._start).props("unelevated no-caps")
            self._stop = ui.button("Stop", icon="stop", on_click=self._end).props("outline no-caps")
            ui.button("Save as preset", icon="save", on_click=self._save).props("flat no-caps")

    def _show_rows(self) -> None:
        self._rows.clear()
        with self._rows:
            for name, source in self._sources.items():
                self._row(name, source)
            if not self._sources:
                ui.label("Add cameras from the list of those found, or by address.").classes("pf-about")

    def _row(self, name: str, source: str) -> None:
        with ui.row().classes("items-center gap-3 w-full no-wrap pf-camera-row"):
            field = ui.input("Name", value=name).props("dense").classes("w-32")
            field.on("blur", lambda: self._rename(name, (field.value or "").strip()))
            ui.label(source).classes("pf-small pf-grow")
            remove = ui.button(icon="close", on_click=lambda: self._remove(name)).props("flat dense round")
            remove.props["aria-label"] = f"Remove {name}"

    def _rename(self, old: str, new: str) -> None:
        if new == old or not new:
            return
        try:
            check_name(new)
            if new in self._sources:
                raise InputError(f"{new}: there is a camera of this name already")
        except InputError as error:
            refused(error)
            self._show_rows()
            return
        self._sources = {new if name == old else name: source for name, source in self._sources.items()}
        self._show_rows()

    def _remove(self, name: str) -> None:
        self._sources.pop(name, None)
        self._show_rows()

    def _start(self) -> None:
        if not self._sources:
            ui.notify("Add a camera first", type="warning")
            return
        try:
            self._studio.jobs.free_cameras()
            self._studio.jobs.start(WATCH, f"Images of {len(self._sources)} cameras", {"sources": self._sources}, page="/")
        except InputError as error:
            refused(error)

    def _end(self) -> None:
        for job in self._studio.jobs.running(WATCH):
            self._studio.jobs.cancel(job.id)

    def _load(self, name: str | None) -> None:
        if not name:
            return
        setup = setup_named(self._studio.workspace, name)
        self._sources, self._rig = dict(setup.sources), setup.rig
        self._show_rows()

    async def _save(self) -> None:
        known = [one.name for one in setups(self._studio.workspace) if one.name != DEMO]

        def save() -> None:
            setup = Setup(name=name.value.strip(), sources=self._sources, rig=rig.value or "")
            try:
                save_setup(self._studio.workspace, setup)
            except PosefuseError as error:
                refused(error)
                return
            ui.notify(f"Saved as {setup.name}", type="positive")
            dialog.submit(True)

        def delete() -> None:
            delete_setup(self._studio.workspace, str(self._preset.value))
            ui.notify(f"{self._preset.value}: deleted; its videos and rig stay")
            dialog.submit(True)

        with ui.dialog() as dialog, ui.card().classes("gap-3"):
            name = ui.input("Name of the preset", value=self._preset.value or "room").classes("w-64")
            rigs = ["", *self._studio.workspace.files(".toml")]
            rig = ui.select(rigs, value=self._rig if self._rig in rigs else "", label="Rig file, if calibrated already").classes(
                "w-64"
            )
            with ui.row().classes("w-full justify-between"):
                if self._preset.value in known:
                    ui.button(f"Delete {self._preset.value}", on_click=delete).props("flat no-caps color=negative")
                ui.space()
                ui.button("Save", on_click=save).props("unelevated no-caps")
        await dialog
        self._show_presets()

    def _show_presets(self) -> None:
        self._preset.set_options([one.name for one in setups(self._studio.workspace) if one.name != DEMO])

    def _refresh(self) -> None:
        watch = self._studio.watch
        self._look.set_visibility(watch.job is None)
        self._stop.set_visibility(watch.job is not None)
        cameras: Mapping[str, Any] = watch.status.get("cameras", {})
        last = None if watch.job is not None else self._last_error()
        state = (tuple(cameras), tuple(one["size_wh"] is not None for one in cameras.values()), watch.job is not None, last)
        if state != self._tiles_of:
            self._tiles_of = state
            self._tiles.clear()
            with self._tiles:
                self._fill(cameras, watch.job is not None, last)
        for refresh in self._refreshers:
            refresh(cameras)

    def _last_error(self) -> str | None:
        ended = next(iter(self._studio.jobs.all(WATCH)), None)
        return self._studio.jobs.report(ended.id).error if ended is not None and not ended.arguments.get("project") else None

    def _fill(self, cameras: Mapping[str, Any], running: bool, error: str | None) -> None:
        self._refreshers: list[Callable[[Mapping[str, Any]], None]] = []
        if error and "cancelled" not in error:
            light("bad", error)
        if running and not cameras:
            with ui.row().classes("items-center gap-3"):
                ui.spinner()
                ui.label("Opening the cameras")
        elif not cameras:
            ui.label("No images yet: press Show images.").classes("pf-small")
        with ui.element("div").classes("pf-grid-wide"):
            for number, (name, one) in enumerate(cameras.items()):
                width, height = one["size_wh"] or (4, 3)
                with ui.column().classes("pf-tile-box"):
                    CameraTile(WATCH, number, aspect=width / height, name=name, overlay=False)
                    self._refreshers.append(_state_line(name))


def _state_line(camera: str) -> Callable[[Mapping[str, Any]], None]:
    with ui.row().classes("pf-tile-foot"):
        place = ui.row()
        figures = ui.label("").classes("pf-small")
    why = ui.label("").classes("pf-small")
    shown: list[str] = []

    def refresh(cameras: Mapping[str, Any]) -> None:
        one = cameras.get(camera)
        if one is None:
            return
        word = "bad" if one["state"] in ("lost", "ended") else "doubt" if one["text"] else "good"
        if shown != [word]:
            shown[:] = [word]
            place.clear()
            with place:
                light(word, camera)
        size = "" if one["size_wh"] is None else f"{one['size_wh'][0]}x{one['size_wh'][1]}, "
        missing = f", {one['missing']} lost" if one["missing"] else ""
        figures.set_text(f"{size}{one['rate_hz']:.0f}/s{missing}")
        why.set_text(one["text"])
        why.set_visibility(bool(one["text"]))

    return refresh
