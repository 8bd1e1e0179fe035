"""One recording: videos, 3D, angles and gait events on one timeline; corrections; what can be made of it."""

from __future__ import annotations

import asyncio
import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from nicegui import run, ui

import posefuse as pf
from posefuse.core import InputError, JointAngles, PosefuseError
from posefuse.core.arrays import Array
from posefuse.core.joint_angles import angle_labels
from posefuse.core.palette import colour_of
from posefuse.foundation.output_file import write_text
from posefuse.foundation.parsing import parse_json, plain, read_text
from posefuse.foundation.plugins import list_plugins
from posefuse.foundation.settings import settings_from_mapping
from posefuse_studio.player import ResultPlayer, angles_and_strikes, open_recording
from posefuse_studio.scene import CameraTile, RigScene, first_angles
from posefuse_studio.shell import card, file_address, icon_button, job_lines, light, recent, redrawn, refused, small, title, words
from posefuse_studio.state import Studio
from posefuse_studio.workspace import check_name, recording_place

_POLL_S = 0.1
_NO_VIDEOS = "No videos of this recording were found in the workspace: none were kept, they are elsewhere, or were not finished."
_PAGE_S = 1.0
_SPEEDS = {0.25: "¼", 0.5: "½", 1.0: "1×", 2.0: "2×"}
_FIRST_FORMATS = ("trc", "c3d", "csv")


def build(studio: Studio, name: str) -> None:
    """Place the page of a recording; it is read after the page is there."""
    client = ui.context.client
    with ui.row().classes("pf-tools"):
        ui.link("All recordings", "/recordings")
    title(recording_place(name).name, name)
    place = ui.column().classes("pf-page-body")
    with place, ui.row().classes("pf-tools") as waiting:
        ui.spinner()
        small("Reading the recording ...")

    async def load() -> None:
        try:
            path = studio.workspace.existing(name)
            playback = await asyncio.to_thread(open_recording, path, studio.workspace.root)
        except PosefuseError as error:
            waiting.clear()
            with waiting:
                light("bad", studio.workspace.in_names(str(error)))
            return
        if client.is_deleted:
            playback.close()
            return
        waiting.delete()
        stream = studio.page_stream(client)
        player = ResultPlayer(playback, studio.streams[stream])
        client.on_delete(player.close)
        with place:
            elements = _Recording(studio, name, player, stream)
        player.start()
        # in another process, as it compiles code, which would hold up every page
        found = await run.cpu_bound(angles_and_strikes, path)
        if found is not None and not client.is_deleted:
            elements.show_angles(*found)

    ui.timer(0.05, load, once=True)


class _Recording:
    """The elements of one visitor."""

    def __init__(self, studio: Studio, name: str, player: ResultPlayer, stream: str) -> None:
        self._player = player
        self._drawn: object = None
        self._joints: JointAngles | None = None
        self._strikes: Sequence[Mapping[str, Array]] = ()
        self._empty = "Angles are being worked out ..."
        with ui.element("div").classes("pf-split"):
            self._videos(stream)
            with card("3D") as head:
                scene = RigScene(stream, trails=False)
                with head:
                    scene.view_buttons()
        self._transport()
        self._angles()
        with ui.element("div").classes("pf-split"):
            self._edit = EditCard(studio, name, player.recording, lambda: self._player.t_s)
            with ui.element("div").classes("pf-column"):
                _output_card(studio, name, player.recording)
                job_lines(studio, recent("solve", "report", "export", about=name))
        ui.timer(_POLL_S, self._follow)

    def _videos(self, stream: str) -> None:
        playback, tiles = self._player.playback, list[CameraTile]()
        with card("Videos") as head:
            if not playback.has_images:
                small(_NO_VIDEOS)
                return
            with head:
                CameraTile.overlay_switch(tiles)
            with ui.element("div").classes("pf-player-tiles"):
                for c, camera in enumerate(playback.recording.rig):
                    with ui.column().classes("pf-tile-box"):
                        tiles.append(CameraTile(stream, c, aspect=camera.size_wh[0] / camera.size_wh[1], name=camera.name))
                        small(": ".join(filter(None, (camera.name, playback.problems.get(camera.name)))))

    def _transport(self) -> None:
        player = self._player
        with card(classes="pf-transport"), ui.row().classes("pf-transport-row"):
            icon_button("skip_previous", "One frame back", lambda: player.step(-1))
            self._play = icon_button("play_arrow", "Play or pause", player.toggle).props(remove="flat")
            icon_button("skip_next", "One frame on", lambda: player.step(1))
            self._slider = ui.slider(min=player.begin_s, max=max(player.end_s, player.begin_s + 1e-3), step=0.001)
            # only what the hand moves comes back: the slider follows the player, too
            self._slider.on("update:model-value", lambda event: player.seek(float(event.args)), throttle=0.05)
            self._slider.props('aria-label="Time"').classes("pf-time")
            self._time = ui.label("").classes("pf-clock")
            speed = ui.select(_SPEEDS, value=1.0, on_change=lambda event: setattr(player, "speed", event.value))
            speed.props('dense outlined aria-label="Speed"')

    def _angles(self) -> None:
        player, people = self._player, dict(enumerate(self._player.recording.person_names))
        keys = {
            "left": lambda: player.step(-1),
            "right": lambda: player.step(1),
            "page-up": lambda: player.seek(player.t_s - _PAGE_S),
            "page-down": lambda: player.seek(player.t_s + _PAGE_S),
            "home": lambda: player.seek(player.begin_s),
            "end": lambda: player.seek(player.end_s),
            "space": player.toggle,
        }
        with card("Angles and gait events") as head:
            with head:
                self._person = ui.select(people, value=0 if people else None, on_change=self._redraw)
                self._person.props('dense outlined aria-label="Person"').set_visibility(bool(people))
                self._chosen = ui.select({}, multiple=True, value=[], on_change=self._redraw)
                self._chosen.props('dense outlined aria-label="Angles"')
            self._timeline = CurveTimeline(player.begin_s, player.end_s, player.seek, keys)
            self._redraw()

    def show_angles(self, joints: JointAngles | None, strikes: Sequence[Mapping[str, Array]]) -> None:
        """Take the angles and foot strikes when they are there."""
        self._joints, self._strikes, self._empty = joints, strikes, ""
        names = [] if joints is None else angle_labels(joints, " ")
        self._chosen.set_options({name: words(name) for name in names}, value=first_angles(names))
        self._redraw()

    def _redraw(self) -> None:
        n = self._person.value
        strikes = self._strikes[n] if self._strikes and n is not None else {}
        joints = self._joints
        curves = {} if n is None or joints is None else {text: _degrees(joints, n, text) for text in self._chosen.value}
        self._timeline.show(self._player.times_s, curves, strikes, "No person was seen." if n is None else self._empty)

    def _follow(self) -> None:
        """Bring what shows the time up to date."""
        state = (self._player.t_s, self._player.playing, self._edit.edits, self._edit.marked_s)
        if state == self._drawn:
            return
        self._drawn = state
        t_s = round(self._player.t_s, 3)
        self._time.set_text(f"{t_s:.3f} s")
        self._slider.set_value(t_s)
        self._play.set_icon("pause" if self._player.playing else "play_arrow")
        self._timeline.move(t_s)
        self._timeline.mark(self._edit.edits.exclusions, self._edit.marked_s)


def _output_card(studio: Studio, name: str, recording: pf.Recording) -> None:
    """What can be made of a recording: its report, and files for other programs."""
    workspace, page = studio.workspace, recording.report_page
    formats = [one.name for one in list_plugins("outputs") if one.config is not None]

    def start(work: str, what: str, **more: object) -> None:
        studio.jobs.start(work, f"{what} of {name}", {"result": name, **more})

    def export() -> None:
        if not chosen.value:
            raise InputError("Choose a format")
        out = workspace.free_name("exports", recording_place(name).stem)
        start("export", "Files", formats=list(chosen.value), out=out)

    with card("Report and files"):
        with ui.row().classes("pf-tools"):
            ui.button("Make the report", icon="description", on_click=lambda: start("report", "Report"))
            if page is not None and page.is_file():
                ui.link("Open the earlier report", file_address(workspace.name_of(page)), new_tab=True)
        with ui.row().classes("pf-tools"):
            first = [one for one in _FIRST_FORMATS if one in formats]
            chosen = ui.select(formats, multiple=True, value=first, label="Formats").classes("pf-formats")
            chosen.props("dense outlined use-chips")
            ui.button("Export", icon="file_download", on_click=export)


def _degrees(joints: JointAngles, n: int, text: str) -> Array:
    """(T,) an angle of the person at place n, by the words that choose it."""
    joint, angle = text.split(" ", 1)
    return joints.of(int(joints.person_id[n]))[joint, angle].deg


# Corrections next to the recording that they are about: kept until they are changed, used by "Solve again".

_FORMAT = "posefuse edits"


def edits_path(recording: Path) -> Path:
    """Where the corrections of a result folder, or of the .mcap of a live session, are kept."""
    return recording / "edits.json" if recording.is_dir() else recording.with_name(f"{recording.stem}.edits.json")


def read_edits(recording: Path) -> pf.Edits | None:
    """The corrections kept for a recording; None where nothing was kept, which is not the same as that all were taken back.

    Raises:
        InputError: a file of this name that posefuse did not write. ConfigError: a wrong value in it.
    """
    path = edits_path(recording)
    if not path.is_file():
        return None
    content = parse_json(str(path), read_text(path))
    if not isinstance(content, dict) or content.pop("format", None) != _FORMAT:
        raise InputError(f"{path}: not edits of posefuse; move it away")
    return settings_from_mapping(content, pf.Edits, where=str(path))


def write_edits(recording: Path, edits: pf.Edits) -> None:
    """Keep the corrections of a recording in place of the earlier ones.

    Raises:
        InputError: it cannot be written, or a file of this name is not one of posefuse.
    """
    read_edits(recording)  # never written over unless it is ours
    about = {"format": _FORMAT, **plain(dataclasses.asdict(edits))}
    write_text(edits_path(recording), json.dumps(about, indent=2, ensure_ascii=False) + "\n")


_ALL = "all cameras (a bad stretch)"
_ALL_PEOPLE = -1


class EditCard:
    """The card.

    Args:
        name: of the recording in the workspace. now: where the player stands, session seconds.

    Attributes:
        edits: as they are kept.
    """

    def __init__(self, studio: Studio, name: str, recording: pf.Recording, now: Callable[[], float]) -> None:
        self._studio, self._name, self._recording, self._now = studio, name, recording, now
        self._from_s: float | None = None
        self._path = studio.workspace.existing(name)
        self.edits = pf.Edits()
        self._read(refused)
        with card("Corrections"):
            small("Mark what should not count, then solve again: without new detection, and this recording stays.")
            with ui.row().classes("pf-tools"):
                self._camera = ui.select([_ALL, *recording.rig.names], value=_ALL, label="Leave out").props("dense outlined")
                self._begin = ui.button("Begin here", icon="first_page", on_click=lambda: self._mark(self._now())).props(
                    "outline"
                )
                self._end = ui.button("End here", icon="last_page", on_click=self._add)
                self._end.set_enabled(False)
            self._show = redrawn(lambda: self._read().exclusions, self._list, classes="pf-edits")
            self._people()
            with ui.row().classes("pf-tools"):
                self._out = ui.input("New name", value=recording_place(name).stem + "-edited").props("dense outlined")
                ui.button("Solve again", icon="replay", on_click=self._start)

    @property
    def marked_s(self) -> tuple[float, float] | None:
        """The stretch from the mark to where the player stands; None while none is marked."""
        if self._from_s is None:
            return None
        return min(self._from_s, self._now()), max(self._from_s, self._now())

    def _people(self) -> None:
        names = self._names
        with ui.row().classes("pf-tools"):
            ui.select(
                {_ALL_PEOPLE: "all people", **names},
                value=_ALL_PEOPLE if self.edits.person is None else self.edits.person,
                label="Keep",
                on_change=lambda event: self._change(person=None if event.value == _ALL_PEOPLE else event.value),
            ).props("dense outlined")
            for person, name in names.items():
                field = ui.input(f"Name of person {person}", value=name, on_change=lambda e, p=person: self._rename(p, e.value))
                field.props("dense outlined debounce=600")

    @property
    def _names(self) -> dict[int, str]:
        """By id, as corrected."""
        earlier = zip(self._recording.poses.person_id.tolist(), self._recording.person_names, strict=True)
        return {person: self.edits.names[person] if person < len(self.edits.names) else name for person, name in earlier}

    def _read(self, show: Callable[[str], object] = bool) -> pf.Edits:
        """As they are kept now: another page may show the same recording. `show`: is given why they cannot be read."""
        try:
            kept = read_edits(self._path)
            self.edits = self._recording.edits if kept is None else kept
        except PosefuseError as error:
            show(self._studio.workspace.in_names(str(error)))
        return self.edits

    def _mark(self, from_s: float | None) -> None:
        self._from_s = from_s
        self._begin.set_text("Begin here" if from_s is None else f"From {from_s:.2f} s")
        self._end.set_enabled(from_s is not None)

    def _add(self) -> None:
        if self.marked_s is not None:
            start_s, end_s = (round(t_s, 3) for t_s in self.marked_s)
            camera = None if self._camera.value == _ALL else self._camera.value
            self._change(exclusions=(*self._read().exclusions, pf.Exclusion(start_s=start_s, end_s=end_s, camera=camera)))
            self._mark(None)

    def _rename(self, person: int, name: str) -> None:
        if name.strip():
            names, known = list(self._read().names), self._names
            names += [known.get(i, f"person {i}") for i in range(len(names), max(known) + 1)]
            names[person] = name.strip()[:64]
            self._change(names=tuple(names))

    def _change(self, **changes: object) -> None:
        edits: pf.Edits = dataclasses.replace(self._read(), **changes)  # type: ignore[arg-type]
        write_edits(self._path, edits)
        self.edits = edits
        self._show()

    def _list(self, exclusions: tuple[pf.Exclusion, ...]) -> None:
        for one in exclusions:
            with ui.row().classes("pf-edit"):
                ui.icon("content_cut")
                ui.label(f"{one.camera or 'all cameras'}, {one.start_s:.2f} to {one.end_s:.2f} s")
                others = tuple(other for other in exclusions if other is not one)
                icon_button("close", "Remove", lambda others=others: self._change(exclusions=others))

    def _start(self) -> None:
        workspace = self._studio.workspace
        check_name(self._out.value)
        parent = recording_place(self._name).parent.as_posix()
        # without the "./" of a recording at the top
        out = PurePosixPath(workspace.free_name(parent, self._out.value)).as_posix()
        arguments = {"result": self._name, "out": out, "edits": plain(dataclasses.asdict(self.edits))}
        self._studio.jobs.start("solve", f"Solve {self._name} again", arguments)
        ui.notify(f"Solving again into {out}")


_MOST_POINTS = 600
# of the curves within the element; the style has the same
_GRID = {"left": 52, "right": 12, "top": 30, "bottom": 30}
_GREY, _FONT = "#78909c", {"color": "#78909c", "fontSize": 13}
_ABOUT = "Timeline: arrows go frame by frame, page keys by a second, space plays and pauses"
# the place of the pointer as a share of the width, while a button is pressed
_POINTED = "(event) => event.buttons && emit(event.offsetX / event.currentTarget.clientWidth)"


class CurveTimeline:
    """The element.

    Args:
        begin_s, end_s: session seconds. seek: goes to a time. keys: what keys do while it has the focus, by name.
    """

    def __init__(
        self, begin_s: float, end_s: float, seek: Callable[[float], object], keys: Mapping[str, Callable[[], object]]
    ) -> None:
        self._begin_s, self._end_s = begin_s, max(end_s, begin_s + 1e-3)
        with ui.element("div").classes("pf-timeline-frame"), ui.element("div").classes("pf-timeline") as frame:
            self._chart = ui.echart({})
            with ui.element("div").classes("pf-timeline-over") as over:
                self._bands = ui.element("div")
                self._cursor = ui.element("div").classes("pf-cursor")
        for pressed in ("mousedown", "mousemove"):
            over.on(pressed, lambda event: seek(self.t_s(float(event.args))), js_handler=_POINTED, throttle=0.05)
        frame.props(f'tabindex=0 role="slider" aria-label="{_ABOUT}" aria-valuemin={begin_s:.3f} aria-valuemax={end_s:.3f}')
        for key, act in keys.items():
            frame.on(f"keydown.{key}.prevent", act)
        self._frame = frame

    def t_s(self, share: float) -> float:
        """The time at a share of the width, within the recording."""
        return self._begin_s + min(max(share, 0.0), 1.0) * (self._end_s - self._begin_s)

    def share(self, t_s: float) -> float:
        """The other way round."""
        return min(max((t_s - self._begin_s) / (self._end_s - self._begin_s), 0.0), 1.0)

    def show(self, t_s: Array, curves: Mapping[str, Array], strikes: Mapping[str, Array], empty: str = "") -> None:
        """Draw curves and foot strikes; see `chart_options`."""
        self._chart.options.clear()
        self._chart.options.update(chart_options((self._begin_s, self._end_s), t_s, curves, strikes, empty))
        self._chart.update()

    def move(self, t_s: float) -> None:
        """Place the cursor."""
        self._cursor.style(f"left: {self.share(t_s):.3%}")
        self._frame.props(f"aria-valuenow={t_s}")

    def mark(self, exclusions: Sequence[pf.Exclusion], marked_s: tuple[float, float] | None) -> None:
        """Show excluded ranges, and the one that is being marked."""
        bands = [(one.start_s, one.end_s, "pf-excluded", one.camera or "all cameras") for one in exclusions]
        bands += [(*marked_s, "pf-marked", "")] if marked_s is not None else []
        self._bands.clear()
        with self._bands:
            for start_s, end_s, kind, text in bands:
                left, right = self.share(start_s), self.share(end_s)
                ui.label(text).classes(f"pf-band {kind}").style(f"left: {left:.3%}; width: {right - left:.3%}")


def chart_options(
    span_s: tuple[float, float], t_s: Array, curves: Mapping[str, Array], strikes: Mapping[str, Array], empty: str = ""
) -> dict[str, Any]:
    """Curves over time with gaps where values are missing, foot strikes as ticks at the bottom.

    Args:
        span_s: from, to. t_s: (T,) session seconds. curves: (T,) degrees by the name of the angle, whose side gives the colour.
        strikes: by side, session seconds. empty: the text where there is no curve.
    """
    known = np.concatenate([one[np.isfinite(one)] for one in curves.values()] or [np.zeros(0)])
    low, high = (float(known.min()), float(known.max())) if len(known) else (-1.0, 1.0)
    room = 0.08 * (high - low) + 1e-3
    # of a long recording every n-th value
    every = max(1, len(t_s) // _MOST_POINTS)
    lines: list[dict[str, Any]] = [
        {"type": "line", "name": words(name), "showSymbol": False, "color": colour_of(name).on_light,
         "data": [[t, value if np.isfinite(value) else None]
                  for t, value in zip(t_s[::every].tolist(), values[::every].tolist(), strict=True)]}
        for name, values in curves.items()
    ]  # fmt: skip
    ticks = [
        {"type": "scatter", "symbol": "rect", "symbolSize": [3, 14], "color": colour_of(f"{side}_foot").on_light,
         "data": [[t, low - room] for t in times.tolist()]}
        for side, times in strikes.items()
    ]  # fmt: skip
    axis = {"axisLabel": _FONT, "axisLine": {"show": False}, "axisTick": {"show": False}}
    faint = {"lineStyle": {"color": _GREY, "opacity": 0.3}}
    return {
        "animation": False, "grid": _GRID, "series": [*lines, *ticks],
        "title": {"text": "" if curves else empty, "left": _GRID["left"], "textStyle": _FONT},
        "legend": {"left": _GRID["left"], "top": 0, "data": [*map(words, curves)], "textStyle": _FONT},
        "xAxis": {"type": "value", "min": span_s[0], "max": span_s[1], **axis, "splitLine": {"show": False},
                  "axisLabel": {**_FONT, "formatter": "{value} s", "showMinLabel": False, "showMaxLabel": False}},
        "yAxis": {"type": "value", "min": low - room, "max": high + room, **axis, "show": bool(curves), "splitLine": faint,
                  "axisLabel": {**_FONT, "formatter": "{value}°", "showMinLabel": False, "showMaxLabel": False}},
    }  # fmt: skip
