"""Cameras: what there is to see with, under names, saved as presets."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

from nicegui import ui

from posefuse.core import InputError
from posefuse.foundation.plugins import sources_of_others
from posefuse_studio.jobs import WATCH
from posefuse_studio.setups import Setup, delete_setup, found_sources, presets, save_setup, setup_named
from posefuse_studio.shell import camera_tiles, card, dialog, icon_button, job_lines, recent, redrawn, refused, small, title
from posefuse_studio.state import Studio
from posefuse_studio.workspace import MOST_UPLOAD_BYTES, check_name

# of an address, by how it begins
_KINDS = ("rtsp://", "rtsps://", "http://", "https://", "usb:", "realsense:", "ros:/")


def build(studio: Studio) -> None:
    """Place the page."""
    title("Cameras", "Choose what to look through, name it, and see that every image is sharp, bright enough and complete.")
    _Chooser(studio).build()


class _Chooser:
    """The cameras that one visitor puts together."""

    def __init__(self, studio: Studio) -> None:
        self._studio = studio
        watching = studio.watch.job
        self._sources: dict[str, str] = dict(watching.arguments.get("sources") or {}) if watching is not None else {}
        self._rig = ""

    def build(self) -> None:
        """Place it."""
        looks = recent(WATCH)
        with ui.element("div").classes("pf-split"):
            with ui.element("div").classes("pf-column"):
                with card("Your cameras") as head:
                    self._draw = redrawn(lambda: dict(self._sources), self._rows, classes="w-full gap-2")
                    with ui.row().classes("gap-3 items-center"):
                        ui.button("Show images", icon="visibility", on_click=self._start).props("unelevated")
                        ui.button("Save as preset", icon="save", on_click=self._save).props("flat")
                with head:
                    self._preset = ui.select(
                        presets(self._studio.workspace), label="Preset", on_change=lambda event: self._load(event.value)
                    )
                    self._preset.props("dense").classes("w-44")
                with card("Images"):
                    # why it failed, too; recordings of a calibration are on its page
                    job_lines(self._studio, lambda job, now: looks(job, now) and not job.arguments.get("folder"), most=1)
                    redrawn(self._images, self._show_images)
            with ui.element("div").classes("pf-column"):
                self._found_card()
                self._address_card()

    def _found_card(self) -> None:
        with card("Found") as head:
            lines = ui.column().classes("w-full gap-1 pf-found")

        async def look() -> None:
            found = await asyncio.to_thread(lambda: list(found_sources(self._studio.workspace)))
            lines.clear()
            with lines:
                for one in found:
                    with ui.row().classes("items-center gap-2 no-wrap w-full"):
                        ui.icon(one.icon).classes("text-primary")
                        ui.label(one.text).classes("pf-grow")
                        icon_button("add", f"Add {one.text}", lambda one=one: self._add(one.name, one.source))
                if not found:
                    small("No camera on USB, and no video in the workspace.")

        with head:
            icon_button("refresh", "Look again", look)
        ui.timer(0.1, look, once=True)

    def _address_card(self) -> None:
        def add() -> None:
            text = (what.value or "").strip()
            kinds = (*_KINDS, *(f"{name}:" for name in sources_of_others()))
            if not text.startswith(kinds):
                raise InputError(f"Expected an address that begins with {', '.join(kinds)}")
            self._add(f"cam{len(self._sources) + 1}", text)
            what.set_value("")

        with card("By address"):
            small("A network camera, a depth camera, a ROS topic; a phone with an RTSP app works, too.")
            with ui.row().classes("items-center gap-2 w-full no-wrap"):
                what = ui.input("e.g. rtsp://192.168.1.20/stream").classes("pf-grow")
                ui.button("Add", on_click=add).props("outline")
        with card("Upload videos"):
            why = f"Expected videos of at most {MOST_UPLOAD_BYTES / 2**30:g} GB; copy others into {self._studio.workspace.root}"
            ui.upload(
                multiple=True,
                auto_upload=True,
                max_file_size=MOST_UPLOAD_BYTES,
                on_upload=self._uploaded,
                on_rejected=lambda: refused(why),
            ).props('accept="video/*" flat bordered label="Press + or drop videos here"')

    async def _uploaded(self, event: Any) -> None:
        name = await self._studio.workspace.upload("videos", event.file.name, event.file.iterate())
        self._add(event.file.name.rpartition(".")[0][:40], f"video:{name}")

    def _add(self, name: str, source: str) -> None:
        stem, number = name.replace(" ", "_"), 1
        name = stem
        while name in self._sources:
            number += 1
            name = f"{stem}_{number}"
        self._sources[name] = source
        self._draw()

    def _rows(self, sources: Mapping[str, str]) -> None:
        for name, source in sources.items():
            with ui.row().classes("items-center gap-3 w-full no-wrap pf-camera-row"):
                field = ui.input("Name", value=name).props("dense").classes("w-32")
                field.on("blur", lambda name=name, field=field: self._rename(name, field))
                small(source).classes("pf-grow")
                icon_button("close", f"Remove {name}", lambda name=name: self._remove(name))
        if not sources:
            ui.label("Add cameras from the list of those found, or by address.").classes("pf-about")

    def _rename(self, old: str, field: ui.input) -> None:
        new = (field.value or "").strip()
        field.set_value(old)
        if new and new != old:
            check_name(new)
            if new in self._sources:
                raise InputError(f"{new}: there is a camera of this name already")
            self._sources = {new if name == old else name: source for name, source in self._sources.items()}
            self._draw()

    def _remove(self, name: str) -> None:
        self._sources.pop(name, None)
        self._draw()

    def _start(self) -> None:
        if not self._sources:
            raise InputError("Add a camera first")
        self._studio.jobs.start(WATCH, f"Images of {', '.join(self._sources)}", {"sources": self._sources})

    def _load(self, name: str | None) -> None:
        if name:
            setup = setup_named(self._studio.workspace, name)
            self._sources, self._rig = dict(setup.sources), setup.rig
            self._draw()

    def _save(self) -> None:
        now, workspace = self._preset.value, self._studio.workspace

        def save() -> None:
            chosen = name.value.strip()
            if chosen != now and chosen in presets(workspace):
                raise InputError(f"{chosen}: there is a preset of this name already; load it to change it")
            save_setup(workspace, Setup(name=chosen, sources=self._sources, rig=rig.value or ""))
            ui.notify(f"Saved as {chosen}", type="positive")
            self._preset.set_options(presets(workspace))

        def delete() -> None:
            delete_setup(workspace, now)
            ui.notify(f"{now}: deleted; its videos and rig stay")
            self._preset.set_options(presets(workspace))

        with dialog("Save as preset", {"Save": save, **({f"Delete {now}": delete} if now else {})}):
            name = ui.input("Name of the preset", value=now or "room").classes("w-64")
            rigs = ["", *workspace.files(".toml")]
            rig = ui.select(rigs, value=self._rig if self._rig in rigs else "", label="Rig file, if calibrated already")
            rig.classes("w-64")

    def _images(self) -> dict[str, object]:
        """Sizes of the images of the cameras that are looked at."""
        return {name: one.size_wh for name, one in self._studio.watch.status.cameras.items()}

    def _show_images(self, sizes: Mapping[str, object]) -> None:
        if sizes:
            camera_tiles(self._studio.watch, WATCH, overlay=False, classes="pf-grid-wide")
        else:
            small("No images yet: Show images opens the cameras.")
