"""Recordings: what was recorded, how good it is, and what can be done with it."""

from __future__ import annotations

import asyncio
import math
import time
from datetime import datetime
from urllib.parse import urlencode

from nicegui import ui

from posefuse_studio.catalogue import Listed, find_recordings, listed
from posefuse_studio.shell import dialog, job_lines, light, network_field, recent, recording_address, small, title
from posefuse_studio.state import Studio
from posefuse_studio.workspace import check_name

from . import recording

# the newest; others are found by a search
_MOST_SHOWN = 60
_POLL_S = 5.0
# while a list is looked through for the first time
_SHOW_EVERY_S = 1.0


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
        title("Recordings", "Everything that was tracked or recorded live in this workspace, the newest first.")
        with ui.row().classes("pf-tools"):
            self._search = ui.input("Search", on_change=self._show).props('clearable outlined dense aria-label="Search"')
            ui.button("Track a study", icon="playlist_play", on_click=self._ask_study).props("outline")
            self._count = small("")
        job_lines(studio, recent("batch", "solve", "simulate_walk"))
        self._grid = ui.element("div").classes("pf-recordings")
        self._show()
        ui.timer(_POLL_S, self._look)

    async def _look(self) -> None:
        """Bring the list up to date; what was not looked at before takes its time, and is shown as it comes."""
        paths = await asyncio.to_thread(find_recordings, self._studio.workspace.root)
        if paths == [one.path for one in self._found]:
            return
        known = {one.path: one for one in self._found}
        self._found = [known.get(path) or Listed(path=path, live=path.suffix == ".mcap") for path in paths]
        shown_s = -math.inf
        for place, path in enumerate(paths):
            if time.monotonic() - shown_s > _SHOW_EVERY_S:
                self._show()
                shown_s = time.monotonic()
            self._found[place] = await asyncio.to_thread(listed, path)
        self._show()

    def _show(self) -> None:
        found = [one for one in self._found if one.matches(self._search.value or "")]
        self._count.set_text(f"{min(len(found), _MOST_SHOWN)} of {len(self._found)}" if self._found else "")
        self._grid.clear()
        with self._grid:
            for one in found[:_MOST_SHOWN]:
                self._card(one)
            if not self._found:
                small("Nothing yet. Record on the page Live, or render a test walk on the page Simulate.")

    def _card(self, one: Listed) -> None:
        name = self._studio.workspace.name_of(one.path)
        with ui.card().classes("pf-card pf-recording-card").props("flat bordered"):
            with ui.link(target=recording_address(name)) as opening:
                # not as text of several properties: a file name may have quotes
                opening.props["aria-label"] = f"Open {name}"
                image = ui.image(f"/studio/thumbnail?{urlencode({'name': name})}").classes("pf-thumbnail")
                image.props("no-spinner ratio=1.7778")
            with ui.row().classes("pf-card-head"):
                ui.link(name, recording_address(name)).classes("pf-recording-name")
            if one.problem:
                light("bad" if not one.live else "off", one.problem.replace(f"{self._studio.workspace.root}/", ""))
                return
            small(about(one))
            small(quality(one))

    def _ask_study(self) -> None:
        def start() -> None:
            self._studio.workspace.existing(study.value)
            check_name(out.value)
            arguments = {"study": study.value, "out": out.value, "networks": network.value}
            self._studio.jobs.start("batch", f"Study {study.value}", arguments)

        with dialog("Track every session below a folder", {"Track all": start}):
            small("Folders such as STUDY/P01/walk1, each with videos and a calibration.")
            study = ui.input("Folder in the workspace")
            out = ui.input("Results", value="study-results")
            network = network_field("the usual one")


def about(one: Listed) -> str:
    """Date, length and people in a line."""
    parts = [
        _date(one),
        f"{one.duration_s:.1f} s" if math.isfinite(one.duration_s) else "",
        ", ".join(one.people),
        f"{one.cameras} cameras" if one.cameras else "",
        "live" * one.live,
        "edited" * one.edited,
    ]
    return " · ".join(filter(None, parts))


def quality(one: Listed) -> str:
    """The figures of its quality in a line."""
    if not math.isfinite(one.coverage):
        return "reading ..."
    figures = [f"{one.coverage:.0%} present"]
    figures += [f"σ {one.sigma_mm:.0f} mm"] if math.isfinite(one.sigma_mm) else []
    figures += [f"{one.reprojection_px:.1f} px"] if math.isfinite(one.reprojection_px) else []
    return ", ".join(figures)


def _date(one: Listed) -> str:
    if one.recorded:
        return one.recorded.replace("T", " ").replace("Z", " UTC")[:16]
    return f"{datetime.fromtimestamp(one.modified_s):%Y-%m-%d %H:%M}" if math.isfinite(one.modified_s) else ""
