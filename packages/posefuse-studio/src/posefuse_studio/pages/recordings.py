"""Recordings: what was recorded, how good it is, and what can be done with it."""

from __future__ import annotations

import asyncio
import math
import time
from datetime import datetime
from urllib.parse import urlencode

from nicegui import ui

from posefuse.core import InputError
from posefuse.pipeline.catalogue import Listed, find_recordings, listed
from posefuse_studio.job_cards import job_cards
from posefuse_studio.shell import card, light, refused, title
from posefuse_studio.state import Studio
from posefuse_studio.workspace import check_name, recording_place

from . import recording

PATH = "/recordings"
_AT_ONCE = 60
_POLL_S = 5.0
# while a list is looked through for the first time
_SHOW_EVERY_S = 1.0
_WORDS = {"good": "good", "doubt": "fair", "bad": "poor", "off": "not known"}


def build(studio: Studio) -> None:
    """Place the page: the list, or one recording where the address names it."""
    name = ui.context.client.request.query_params.get("open", "")
    if name:
        recording.build(studio, name)
    else:
        _List(studio)


class _List:
    """The list of one visitor."""

    def __init__(self, studio: Studio) -> None:
        self._studio = studio
        self._found: list[Listed] = []
        self._names: list[str] = []
        self._chosen: list[str] = []
        self._boxes: dict[str, ui.checkbox] = {}
        self._most = _AT_ONCE
        title("Recordings", "Everything that was tracked or recorded live in this workspace, the newest first.")
        with ui.row().classes("pf-tools"):
            self._search = ui.input("Search", on_change=self._show).props('clearable outlined dense aria-label="Search"')
            self._compare = ui.button("Compare two", icon="compare_arrows", on_click=self._start_compare).props("outline")
            ui.button("Track a study", icon="playlist_play", on_click=self._ask_study).props("outline")
            self._count = ui.label("").classes("pf-small")
        job_cards(studio, ("compare", "batch", "solve", "simulate_walk"))
        self._grid = ui.element("div").classes("pf-recordings")
        self._more = ui.button("Show more", on_click=self._show_more).props("flat")
        self._show()
        ui.timer(0.05, self._load, once=True)
        ui.timer(_POLL_S, self._look_again)

    async def _load(self) -> None:
        root = self._studio.workspace.root
        paths = await asyncio.to_thread(find_recordings, root)
        self._names = [self._studio.workspace.name_of(path) for path in paths]
        known = {one.path: one for one in self._found}
        self._found = [known.get(path) or Listed(path=path, live=path.suffix == ".mcap") for path in paths]
        self._show()
        shown_s = time.monotonic()
        for place, path in enumerate(paths):
            self._found[place] = await asyncio.to_thread(listed, path)
            if time.monotonic() - shown_s > _SHOW_EVERY_S:
                self._show()
                shown_s = time.monotonic()
        self._show()

    async def _look_again(self) -> None:
        paths = await asyncio.to_thread(find_recordings, self._studio.workspace.root)
        if [self._studio.workspace.name_of(path) for path in paths] != self._names:
            await self._load()

    def _show_more(self) -> None:
        self._most += _AT_ONCE
        self._show()

    def _show(self) -> None:
        found = [one for one in self._found if one.matches(self._search.value or "")]
        self._count.set_text(f"{len(found)} of {len(self._found)}" if self._found else "")
        self._more.set_visibility(len(found) > self._most)
        self._compare.set_enabled(len(self._chosen) == 2)
        self._grid.clear()
        self._boxes.clear()
        with self._grid:
            for one in found[: self._most]:
                self._card(one)
            if not self._found:
                ui.label("Nothing yet. Record on the page Live, or render a test walk on the page Simulate.").classes("pf-small")

    def _card(self, one: Listed) -> None:
        name = self._studio.workspace.name_of(one.path)
        address = f"{PATH}?{urlencode({'open': name})}"
        with ui.card().classes("pf-card pf-recording-card").props("flat bordered"):
            with ui.link(target=address) as opening:
                # not as text of several properties: a file name may have quotes
                opening.props["aria-label"] = f"Open {name}"
                ui.image(f"/studio/thumbnail?{urlencode({'name': name})}").classes("pf-thumbnail").props(
                    "no-spinner ratio=1.7778"
                )
            with ui.row().classes("pf-card-head"):
                ui.link(name, address).classes("pf-recording-name")
                ui.space()
                box = ui.checkbox(value=name in self._chosen, on_change=lambda e, n=name: self._choose(n, e.value))
                self._boxes[name] = box.props("dense")
                box.props["aria-label"] = f"Choose {name} to compare"
            if one.problem:
                light("bad" if not one.live else "off", one.problem.replace(f"{self._studio.workspace.root}/", ""))
                return
            ui.label(about(one)).classes("pf-small")
            light(one.mark(), quality(one))

    def _choose(self, name: str, on: bool) -> None:
        """Two at most: a third takes the place of the first."""
        chosen = [*(one for one in self._chosen if one != name), *([name] if on else [])]
        self._chosen = chosen[-2:]
        for dropped in chosen[:-2]:
            if dropped in self._boxes:
                self._boxes[dropped].set_value(False)
        self._compare.set_enabled(len(self._chosen) == 2)

    def _start_compare(self) -> None:
        a, b = self._chosen
        try:
            out = self._studio.workspace.free_name("comparisons", f"{recording_place(a).stem}-{recording_place(b).stem}")
            self._studio.jobs.start("compare", f"Compare {b} with {a}", {"a": a, "b": b, "out": out}, page=PATH)
        except InputError as error:
            refused(error)
            return
        ui.notify("Comparing; the result appears above the list.")

    def _ask_study(self) -> None:
        with ui.dialog() as dialog, card("Track every session below a folder"):
            ui.label("Folders such as STUDY/P01/walk1, each with videos and a calibration.").classes("pf-small")
            study = ui.input("Folder in the workspace")
            out = ui.input("Results", value="study-results")

            def start() -> None:
                try:
                    self._studio.workspace.existing(study.value)
                    check_name(out.value)
                    self._studio.jobs.start("batch", f"Study {study.value}", {"study": study.value, "out": out.value}, page=PATH)
                except InputError as error:
                    refused(error)
                    return
                dialog.close()

            with ui.row():
                ui.button("Track all", on_click=start)
                ui.button("Cancel", on_click=dialog.close).props("flat")
        dialog.open()


def about(one: Listed) -> str:
    """Date, length and people in a line."""
    parts = [_date(one)]
    if math.isfinite(one.duration_s):
        parts.append(f"{one.duration_s:.1f} s")
    if one.people:
        parts.append(", ".join(one.people))
    if one.cameras:
        parts.append(f"{one.cameras} cameras")
    parts += ["live"] * one.live + ["edited"] * one.edited
    return " · ".join(part for part in parts if part)


def quality(one: Listed) -> str:
    """The figures of its quality in a line."""
    if not math.isfinite(one.coverage):
        return "reading ..."
    figures = [f"{one.coverage:.0%} present"]
    if math.isfinite(one.sigma_mm):
        figures.append(f"σ {one.sigma_mm:.0f} mm")
    if math.isfinite(one.reprojection_px):
        figures.append(f"{one.reprojection_px:.1f} px")
    return f"{_WORDS[one.mark()]}: {', '.join(figures)}"


def _date(one: Listed) -> str:
    if one.recorded:
        return one.recorded.replace("T", " ").replace("Z", " UTC")[:16]
    return f"{datetime.fromtimestamp(one.modified_s):%Y-%m-%d %H:%M}" if math.isfinite(one.modified_s) else ""
