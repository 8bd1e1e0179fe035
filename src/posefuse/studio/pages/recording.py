"""One recording: videos, 3D, angles and gait events on one timeline; corrections; what can be made of it."""

from __future__ import annotations

from pathlib import PurePosixPath

import numpy as np
from nicegui import events, run, ui

from posefuse.core import PosefuseError
from posefuse.studio.edit_card import EditCard
from posefuse.studio.job_cards import job_cards
from posefuse.studio.output_card import output_card
from posefuse.studio.player import Player, open_recording
from posefuse.studio.scene.view import CameraTile, RigScene
from posefuse.studio.shell import card, refused, title
from posefuse.studio.state import Studio
from posefuse.studio.timeline import SIZE_PX, Curve, Span, cursor, picture

_POLL_S = 0.1
_SPEEDS = {0.25: "¼", 0.5: "½", 1.0: "1×", 2.0: "2×"}
_FIRST_ANGLES = (("knee", "flexion"), ("hip", "flexion"))


def build(studio: Studio, name: str) -> None:
    """Place the page of a recording; it is read after the page is there."""
    client = ui.context.client
    with ui.row().classes("pf-tools"):
        ui.link("All recordings", "/recordings")
    title(PurePosixPath(name).name, name)
    place = ui.column().classes("pf-page-body")
    with place:
        with ui.row().classes("pf-tools") as waiting:
            ui.spinner()
            ui.label("Reading the recording ...").classes("pf-small")

    async def load() -> None:
        try:
            path = studio.workspace.existing(name)
            opened = await run.io_bound(open_recording, path, studio.workspace.root)
        except PosefuseError as error:
            waiting.clear()
            refused(error)
            return
        waiting.delete()
        stream = f"recording-{client.id}"
        player = Player(opened, studio.stream(stream))

        def leave() -> None:
            player.close()
            studio.drop_stream(stream)

        client.on_delete(leave)
        with place:
            _Recording(studio, name, player, stream)
        player.start()

    ui.timer(0.05, load, once=True)


class _Recording:
    """The elements of one visitor."""

    def __init__(self, studio: Studio, name: str, player: Player, stream: str) -> None:
        self._player, self._opened = player, player.opened
        self._span = Span(player.begin_s, player.end_s)
        self._drawn: object = None
        with ui.element("div").classes("pf-split"):
            self._videos(stream)
            with card("3D") as head:
                with head:
                    ui.space()
                    for where in ("home", "top", "front", "side"):
                        ui.button(where, on_click=lambda w=where: scene.look(w)).props("flat dense no-caps")
                scene = RigScene(stream, trails=False)
        self._transport()
        self._angles()
        with ui.element("div").classes("pf-split"):
            self._edit = EditCard(studio, name, self._opened.recording, lambda: self._player.t_s)
            with ui.element("div").classes("pf-column"):
                output_card(studio, name)
                job_cards(studio, ("solve_again", "report", "export"), about=name)
        ui.timer(_POLL_S, self._follow)

    def _videos(self, stream: str) -> None:
        with card("Videos") as head:
            tiles: list[CameraTile] = []
            with head:
                ui.space()
                ui.switch("Overlay", value=True, on_change=lambda e: [tile.show(e.value) for tile in tiles])
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
            self._slider = ui.slider(
                min=player.begin_s, max=max(player.end_s, player.begin_s + 1e-3), step=0.001, value=player.t_s,
                on_change=lambda e: self._slid(e.value), throttle=0.05,
            ).props('aria-label="Time"').classes("pf-time")  # fmt: skip
            self._time = ui.label("").classes("pf-clock")
            ui.select(_SPEEDS, value=1.0, on_change=lambda e: setattr(player, "speed", e.value)).props(
                'dense outlined aria-label="Speed"'
            )

    def _angles(self) -> None:
        joints = self._opened.joints
        with card("Angles and gait events") as head:
            names = [] if joints is None else [f"{j} {a}" for q, j in enumerate(joints.joints) for a in joints.angle_names[q]]
            people = dict(enumerate(self._opened.recording.person_names))
            with head:
                ui.space()
                self._person = ui.select(people, value=0 if people else None, on_change=self._redraw).props(
                    'dense outlined aria-label="Person"'
                )
                self._chosen = ui.select(names, multiple=True, value=_first(names), on_change=self._redraw).props(
                    'dense outlined aria-label="Angles"'
                )
            self._plot = ui.interactive_image(
                size=SIZE_PX, sanitize=False, events=["mousedown", "mousemove"], on_mouse=self._pointed
            ).classes("pf-timeline")
            self._redraw()

    def _redraw(self) -> None:
        opened, joints, n = self._opened, self._opened.joints, self._person.value
        if n is None or not len(opened.t_s):
            return
        curves = []
        for text in self._chosen.value if joints is not None else ():
            joint, angle = text.split(" ", 1)
            q = joints.joints.index(joint)
            values = np.degrees(joints.angle_rad[:, n, q, joints.angle_names[q].index(angle)])
            curves.append(Curve(text.replace("_", " "), values, joint.split("_")[0] if joint.split("_")[0] in _SIDES else "mid"))
        gait = opened.gaits.get(n)
        strikes = {} if gait is None else {side: times + self._span.begin_s for side, times in gait.strike_s.items()}
        self._plot.set_source(picture(opened.t_s, curves, strikes, "°"))

    def _pointed(self, event: events.MouseEventArguments) -> None:
        if event.type == "mousedown" or event.buttons:
            self._player.seek(self._span.t_s(event.image_x))

    def _slid(self, value: float) -> None:
        # the slider follows the player, too: only what differs was moved by hand
        if abs(value - self._player.t_s) > 1e-3:
            self._player.seek(value)

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
        self._play.props(f"icon={'pause' if self._player.playing else 'play_arrow'}")
        self._plot.set_content(cursor(self._span, self._player.t_s, self._edit.edits.exclusions, self._edit.marked_s))


_SIDES = ("left", "right")


def _first(names: list[str]) -> list[str]:
    """The angles shown at first: knees, or whatever there is."""
    for joint, angle in _FIRST_ANGLES:
        found = [f"{side}_{joint} {angle}" for side in _SIDES if f"{side}_{joint} {angle}" in names]
        if found:
            return found
    return names[:2]



