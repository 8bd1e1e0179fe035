"""One recording: videos, 3D, angles and gait events on one timeline; corrections; what can be made of it."""

from __future__ import annotations

import asyncio

import numpy as np
from nicegui import run, ui

from posefuse.core import JointAngles, PosefuseError
from posefuse.core.joint_angles import angle_labels
from posefuse.foundation.plugins import list_plugins
from posefuse.pipeline.reports import PAGE_FILE, report_folder
from posefuse_studio.edit_card import EditCard
from posefuse_studio.player import ResultPlayer, angles_of_file, open_recording
from posefuse_studio.scene.view import VIEWS, CameraTile, RigScene
from posefuse_studio.shell import card, file_address, icon_button, job_cards, light, refusals, small, title, words
from posefuse_studio.state import Studio
from posefuse_studio.timeline import Curve, CurveTimeline
from posefuse_studio.workspace import recording_place

_POLL_S = 0.1
_NO_VIDEOS = "No videos of this recording were found in the workspace: none were kept, they are elsewhere, or were not finished."
_PAGE_S = 1.0
_SPEEDS = {0.25: "¼", 0.5: "½", 1.0: "1×", 2.0: "2×"}
_SIDES = ("left", "right")
_FIRST_ANGLES = (("knee", "flexion"), ("hip", "flexion"))
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
            opened = await asyncio.to_thread(open_recording, path, studio.workspace.root)
        except PosefuseError as error:
            waiting.clear()
            with waiting:
                light("bad", str(error).replace(f"{studio.workspace.root}/", ""))
            return
        if client.is_deleted:
            opened.playback.close()
            return
        waiting.delete()
        stream = f"recording-{client.id}"
        player = ResultPlayer(opened, studio.stream(stream))

        def leave() -> None:
            player.close()
            studio.drop_stream(stream)

        client.on_delete(leave)
        with place:
            elements = _Recording(studio, name, player, stream)
        player.start()
        # in another process, as it compiles code, which would hold up every page
        joints = await run.cpu_bound(angles_of_file, path)
        if not client.is_deleted:
            elements.show_angles(joints)

    ui.timer(0.05, load, once=True)


class _Recording:
    """The elements of one visitor."""

    def __init__(self, studio: Studio, name: str, player: ResultPlayer, stream: str) -> None:
        self._player, self._opened = player, player.opened
        self._drawn: object = None
        self._joints: JointAngles | None = None
        self._empty = "Angles are being worked out ..."
        with ui.element("div").classes("pf-split"):
            self._videos(stream)
            with card("3D") as head:
                scene = RigScene(stream, trails=False)
                with head:
                    for where, text in VIEWS.items():
                        ui.button(text, on_click=lambda w=where: scene.look(w)).props("flat dense")
        self._transport()
        self._angles()
        with ui.element("div").classes("pf-split"):
            self._edit = EditCard(studio, name, self._opened.recording, lambda: self._player.t_s)
            with ui.element("div").classes("pf-column"):
                _output_card(studio, name)
                job_cards(studio, ("solve", "report", "export"), about=name)
        ui.timer(_POLL_S, self._follow)

    def _videos(self, stream: str) -> None:
        playback, tiles = self._opened.playback, list[CameraTile]()
        with card("Videos") as head:
            with head:
                ui.switch("Overlay", value=True, on_change=lambda event: CameraTile.show(tiles, event.value))
            if not playback.has_images:
                small(_NO_VIDEOS)
                return
            with ui.element("div").classes("pf-player-tiles"):
                for c, camera in enumerate(self._opened.recording.rig):
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
        player, people = self._player, dict(enumerate(self._opened.recording.person_names))
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

    def show_angles(self, joints: JointAngles | None) -> None:
        """Take the angles when they are there."""
        self._joints, self._empty = joints, ""
        names = [] if joints is None else angle_labels(joints, " ")
        self._chosen.set_options({name: words(name) for name in names}, value=_first(names))
        self._redraw()

    def _redraw(self) -> None:
        opened, n = self._opened, self._person.value
        gait = opened.gaits.get(n)
        strikes = {} if gait is None else {side: times + self._player.begin_s for side, times in gait.strike_s.items()}
        curves = [] if n is None or self._joints is None else [_curve(self._joints, n, text) for text in self._chosen.value]
        self._timeline.show(opened.t_s, curves, strikes, "°", "No person was seen." if n is None else self._empty)

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


def _output_card(studio: Studio, name: str) -> None:
    """What can be made of a recording: its report, and files for other programs."""
    workspace = studio.workspace
    page = report_folder(workspace.existing(name)) / PAGE_FILE
    formats = [one.name for one in list_plugins("outputs") if one.config is not None]

    def start(work: str, what: str, **more: object) -> None:
        with refusals():
            studio.jobs.start(work, f"{what} of {name}", {"result": name, **more}, page="/recordings")

    def export() -> None:
        out = workspace.free_name("exports", recording_place(name).stem)
        start("export", "Files", formats=list(chosen.value), out=out)

    with card("Report and files"):
        with ui.row().classes("pf-tools"):
            ui.button("Make the report", icon="description", on_click=lambda: start("report", "Report"))
            if page.is_file():
                ui.link("Open the earlier report", file_address(workspace.name_of(page)), new_tab=True)
        with ui.row().classes("pf-tools"):
            first = [one for one in _FIRST_FORMATS if one in formats]
            chosen = ui.select(formats, multiple=True, value=first, label="Formats").classes("pf-formats")
            chosen.props("dense outlined use-chips")
            ui.button("Export", icon="file_download", on_click=export)


def _curve(joints: JointAngles, n: int, text: str) -> Curve:
    """An angle of the person at place n, by the words that choose it."""
    joint, angle = text.split(" ", 1)
    q = joints.joints.index(joint)
    values = np.degrees(joints.angle_rad[:, n, q, joints.angle_names[q].index(angle)])
    side = joint.split("_")[0]
    return Curve(words(text), values, side if side in _SIDES else "mid")


def _first(names: list[str]) -> list[str]:
    """The angles shown at first: knees, or whatever there is."""
    for joint, angle in _FIRST_ANGLES:
        if found := [name for side in _SIDES if (name := f"{side}_{joint} {angle}") in names]:
            return found
    return names[:2]
