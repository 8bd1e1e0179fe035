"""One recording: videos, 3D, angles and gait events on one timeline; corrections; what can be made of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import numpy as np
from nicegui import events, ui

from posefuse.core import JointAngles, PosefuseError
from posefuse.core.joint_angles import angle_labels
from posefuse_studio.edit_card import EditCard
from posefuse_studio.job_cards import job_cards
from posefuse_studio.output_card import output_card
from posefuse_studio.player import ResultPlayer, load_joint_angles, open_recording
from posefuse_studio.scene.view import VIEWS, CameraTile, RigScene
from posefuse_studio.shell import card, light, title, words
from posefuse_studio.state import Studio
from posefuse_studio.timeline import SIZE_PX, Curve, Span, cursor, picture
from posefuse_studio.workspace import recording_place

_POLL_S = 0.1
_NO_VIDEOS = "No videos of this recording were found in the workspace: none were kept, they are elsewhere, or were not finished."
_TIMELINE = "Timeline: arrows go frame by frame, page keys by a second, space plays and pauses"
_PAGE_S = 1.0
_SPEEDS = {0.25: "¼", 0.5: "½", 1.0: "1×", 2.0: "2×"}
_SIDES = ("left", "right")
_FIRST_ANGLES = (("knee", "flexion"), ("hip", "flexion"))


def build(studio: Studio, name: str) -> None:
    """Place the page of a recording; it is read after the page is there."""
    client = ui.context.client
    with ui.row().classes("pf-tools"):
        ui.link("All recordings", "/recordings")
    title(recording_place(name).name, name)
    place = ui.column().classes("pf-page-body")
    with place, ui.row().classes("pf-tools") as waiting:
        ui.spinner()
        ui.label("Reading the recording ...").classes("pf-small")

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
        joints = await load_joint_angles(path)
        if not client.is_deleted:
            elements.show_angles(joints)

    ui.timer(0.05, load, once=True)


class _Recording:
    """The elements of one visitor."""

    def __init__(self, studio: Studio, name: str, player: ResultPlayer, stream: str) -> None:
        self._player, self._opened = player, player.opened
        self._span = Span(player.begin_s, player.end_s)
        self._drawn: object = None
        self._joints: JointAngles | None = None
        self._worked_out = False
        with ui.element("div").classes("pf-split"):
            self._videos(stream)
            with card("3D") as head:
                scene = RigScene(stream, trails=False)
                with head:
                    ui.space()
                    for where, text in VIEWS.items():
                        ui.button(text, on_click=lambda w=where: scene.look(w)).props("flat dense no-caps")
        self._transport()
        self._angles()
        with ui.element("div").classes("pf-split"):
            self._edit = EditCard(studio, name, self._opened.recording, lambda: self._player.t_s)
            with ui.element("div").classes("pf-column"):
                output_card(studio, name)
                job_cards(studio, ("solve", "report", "export"), about=name)
        ui.timer(_POLL_S, self._follow)

    def _videos(self, stream: str) -> None:
        with card("Videos") as head:
            tiles: list[CameraTile] = []

            def show(overlay: bool) -> None:
                for tile in tiles:
                    tile.show(overlay)

            with head:
                ui.space()
                ui.switch("Overlay", value=True, on_change=lambda e: show(e.value))
            if not self._opened.playback.has_images:
                ui.label(_NO_VIDEOS).classes("pf-small")
                return
            with ui.element("div").classes("pf-player-tiles"):
                for c, camera in enumerate(self._opened.recording.rig):
                    with ui.column().classes("pf-tile-box"):
                        tiles.append(CameraTile(stream, c, aspect=camera.size_wh[0] / camera.size_wh[1], name=camera.name))
                        ui.label(camera.name + self._problem(camera.name)).classes("pf-small")

    def _problem(self, camera: str) -> str:
        why = self._opened.playback.problems.get(camera, "")
        return f": {why}" if why else ""

    def _transport(self) -> None:
        player = self._player
        with card(classes="pf-transport"), ui.row().classes("pf-transport-row"):
            ui.button(icon="skip_previous", on_click=lambda: player.step(-1)).props('flat round aria-label="One frame back"')
            self._play = ui.button(icon="play_arrow", on_click=self._toggle).props('round aria-label="Play or pause"')
            ui.button(icon="skip_next", on_click=lambda: player.step(1)).props('flat round aria-label="One frame on"')
            self._slider = ui.slider(min=player.begin_s, max=max(player.end_s, player.begin_s + 1e-3), step=0.001)
            # only what the hand moves comes back: the slider follows the player, too
            self._slider.on("update:model-value", lambda e: player.seek(float(e.args)), throttle=0.05)
            self._slider.props('aria-label="Time"').classes("pf-time")
            self._time = ui.label("").classes("pf-clock")
            ui.select(_SPEEDS, value=1.0, on_change=lambda e: setattr(player, "speed", e.value)).props(
                'dense outlined aria-label="Speed"'
            )

    def _angles(self) -> None:
        with card("Angles and gait events") as head:
            people = dict(enumerate(self._opened.recording.person_names))
            with head:
                ui.space()
                self._person = ui.select(people, value=0 if people else None, on_change=self._redraw).props(
                    'dense outlined aria-label="Person"'
                )
                self._person.set_visibility(bool(people))
                self._chosen = ui.select({}, multiple=True, value=[], on_change=self._redraw).props(
                    'dense outlined aria-label="Angles"'
                )
            with ui.element("div").classes("pf-timeline-frame"):
                self._plot = ui.interactive_image(
                    size=SIZE_PX, sanitize=False, events=["mousedown", "mousemove"], on_mouse=self._pointed
                ).classes("pf-timeline")
                self._plot.props(f'tabindex=0 role="slider" aria-label="{_TIMELINE}" aria-valuemin={self._span.begin_s:.3f}')
                self._plot.props(f"aria-valuemax={self._span.end_s:.3f}")
                for key, act in self._keys().items():
                    self._plot.on(f"keydown.{key}.prevent", act)
            self._redraw()

    def _keys(self) -> dict[str, Callable[[], object]]:
        """What keys do while the timeline has the focus."""
        player = self._player
        return {
            "left": lambda: player.step(-1),
            "right": lambda: player.step(1),
            "page-up": lambda: player.seek(player.t_s - _PAGE_S),
            "page-down": lambda: player.seek(player.t_s + _PAGE_S),
            "home": lambda: player.seek(player.begin_s),
            "end": lambda: player.seek(player.end_s),
            "space": self._toggle,
        }

    def show_angles(self, joints: JointAngles | None) -> None:
        """Take the angles when they are there."""
        self._joints, self._worked_out = joints, True
        names = [] if joints is None else angle_labels(joints, " ")
        self._chosen.set_options({name: words(name) for name in names}, value=_first(names))
        self._redraw()

    def _redraw(self) -> None:
        opened, n = self._opened, self._person.value
        if not len(opened.t_s):
            return
        gait = opened.gaits.get(n)
        strikes = {} if gait is None else {side: times + self._span.begin_s for side, times in gait.strike_s.items()}
        curves = [] if n is None or self._joints is None else [_curve(self._joints, n, text) for text in self._chosen.value]
        empty = "No person was seen." if n is None else "" if self._worked_out else "Angles are being worked out ..."
        self._plot.set_source(picture(opened.t_s, curves, strikes, "°", empty))

    def _pointed(self, event: events.MouseEventArguments) -> None:
        if event.type == "mousedown" or event.buttons:
            self._player.seek(self._span.t_s(event.image_x))

    async def _toggle(self) -> None:
        if self._player.playing:
            self._player.playing = False
        else:
            await self._player.play()

    def _follow(self) -> None:
        """Bring what shows the time up to date."""
        state = (self._player.t_s, self._player.playing, self._edit.edits, self._edit.marked_s)
        if state == self._drawn:
            return
        self._drawn = state
        t_s = round(self._player.t_s, 3)
        self._time.set_text(f"{t_s:.3f} s")
        self._slider.set_value(t_s)
        self._plot.props(f"aria-valuenow={t_s}")
        self._play.props(f"icon={'pause' if self._player.playing else 'play_arrow'}")
        self._plot.set_content(cursor(self._span, self._player.t_s, self._edit.edits.exclusions, self._edit.marked_s))


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
        found = [f"{side}_{joint} {angle}" for side in _SIDES if f"{side}_{joint} {angle}" in names]
        if found:
            return found
    return names[:2]
