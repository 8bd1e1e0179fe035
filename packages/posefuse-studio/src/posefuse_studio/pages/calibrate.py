"""Calibrate: from cameras to a verified rig, one thing at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from nicegui import ui

from posefuse.core import InputError, PosefuseError, Rig
from posefuse.formats.rig import read_rig
from posefuse_studio.calibrations import (
    FOLDER,
    RIG,
    Known,
    Next,
    Project,
    Step,
    known_of,
    last_worked_on,
    new_recording,
    next_step,
    projects,
    save_project,
)
from posefuse_studio.jobs import Job, Report
from posefuse_studio.pages.calibrate_parts import (
    TITLES,
    graph_card,
    lights_table,
    print_dialog,
    result_card,
    say_aloud,
    steps_table,
)
from posefuse_studio.scene.messages import setup_message
from posefuse_studio.scene.setup import scene_setup
from posefuse_studio.scene.view import CameraTile, RigScene
from posefuse_studio.session_messages import WATCH
from posefuse_studio.setups import DEMO, Setup, save_setup, setup_named, setups
from posefuse_studio.shell import card, job_line, light, refused, title
from posefuse_studio.state import Studio
from posefuse_studio.targets import FLOOR_ID

_REFRESH_S = 0.7
# errors of millimetres would not be seen in a room
_LARGER = 50.0
_NO_FLOOR = (
    f"No marker {FLOOR_ID} was seen on the floor: up is estimated from the cameras, and the height of the floor is not known. Lay"
    " it down and record again, so that people stand on the floor."
)
_BUTTONS: Mapping[str, tuple[str, str]] = {
    "print": ("Print targets", "print"),
    "record": ("Start recording", "fiber_manual_record"),
    "solve": ("Calibrate", "play_arrow"),
    "use": ("Use this rig", "check"),
}


def build(studio: Studio) -> None:
    """Place the page."""
    title("Calibrate", "Where the cameras stand, how their lenses draw, and how far all of it can be trusted.")
    found = projects(studio.workspace)
    chooser = ui.row().classes("items-center gap-3")
    place = ui.column().classes("pf-column w-full")

    def show(name: str) -> None:
        chooser.clear()
        with chooser:
            names = [one.name for one in projects(studio.workspace)]
            if names:
                ui.select(names, value=name, label="Calibration", on_change=lambda event: show(event.value)).classes("w-56")
            ui.button("New", icon="add", on_click=lambda: _new(studio, show)).props("outline no-caps")
        place.clear()
        with place:
            project = next((one for one in projects(studio.workspace) if one.name == name), None)
            if project is None:
                _welcome(studio, show)
            elif project.setup not in {one.name for one in setups(studio.workspace)}:
                _without_cameras(project)
            else:
                _Guide(studio, project).build()

    show(last_worked_on(studio.workspace, found))


def _welcome(studio: Studio, show: Callable[[str], None]) -> None:
    with card():
        ui.label("Choose the cameras to calibrate").classes("pf-next")
        ui.label("A calibration belongs to a preset of the page Cameras, and can be repeated at any time.").classes("pf-about")
        ui.button("New calibration", icon="add", on_click=lambda: _new(studio, show)).props("unelevated no-caps size=lg").classes(
            "self-start"
        )


def _without_cameras(project: Project) -> None:
    with card():
        ui.label(f"The preset {project.setup} is missing").classes("pf-next")
        ui.label(
            f"The calibration {project.name} belongs to these cameras. Save them under this name again on the page Cameras, or"
            " begin a new calibration."
        ).classes("pf-about")


async def _new(studio: Studio, show: Callable[[str], None]) -> None:
    names = [one.name for one in setups(studio.workspace) if one.name != DEMO]
    if not names:
        ui.notify("First name and save the cameras on the page Cameras", type="warning")
        return
    with ui.dialog() as dialog, ui.card().classes("gap-3"):
        ui.label("New calibration").classes("pf-h2")
        name = ui.input("Name", value=studio.workspace.free_name(FOLDER, "room").rpartition("/")[2]).classes("w-64")
        setup = ui.select(names, value=names[-1], label="Cameras").classes("w-64")
        lenses = ui.checkbox("Calibrate the lenses first (more exact)", value=True)

        def begin() -> None:
            project = Project(name=name.value.strip(), setup=str(setup.value), lenses=bool(lenses.value))
            try:
                if project.name in {one.name for one in projects(studio.workspace)}:
                    raise InputError(f"{project.name}: there is a calibration of this name; each of its steps can be done again")
                save_project(studio.workspace, project)
            except PosefuseError as error:
                refused(error)
                return
            dialog.submit(project.name)

        with ui.row().classes("w-full justify-end"):
            ui.button("Begin", on_click=begin).props("unelevated no-caps")
    if made := await dialog:
        show(made)


class _Guide:
    """One project as one visitor sees it."""

    def __init__(self, studio: Studio, project: Project) -> None:
        self._studio, self._project = studio, project
        self._setup = setup_named(studio.workspace, project.setup)
        self._state: Any = None
        self._sound = False
        self._said = ""
        self._tiled: dict[str, Any] = {}
        self._solving: Report | None = None
        self._linked: tuple[list[str], Any] | None = None

    def build(self) -> None:
        """Place it, and keep it as the files are."""
        with card() as head:
            self._words = ui.label("").classes("pf-next").props('role="status" aria-live="polite"')
            self._why = ui.label("").classes("pf-about")
            self._bar = ui.column().classes("w-full gap-2")
        with head:
            ui.label("What to do next").classes("pf-h2")
            ui.space()
            ui.switch("Sound", on_change=lambda event: self._switch_sound(bool(event.value)))
        self._tiles = ui.column().classes("w-full gap-3")
        self._lights = ui.column().classes("w-full")
        self._steps = ui.column().classes("w-full")
        self._graph = ui.column().classes("w-full")
        self._results = ui.element("div").classes("pf-halves")
        self._refresh()
        ui.timer(_REFRESH_S, self._refresh)

    def _switch_sound(self, on: bool) -> None:
        """The current instruction is spoken immediately, so that the user hears that sound works."""
        self._sound, self._said = on, ""

    def _refresh(self) -> None:
        studio = self._studio
        known = known_of(studio.workspace, self._project, tuple(self._setup.sources))
        watching = studio.watch.job if studio.watch.job is not None and self._is_mine(studio.watch.job) else None
        solving = next((one for one in studio.jobs.running("calibrate")
                        if one.arguments["folder"] == self._project.folder), None)  # fmt: skip
        other = studio.watch.job if watching is None and solving is None else None
        fault = self._fault(known) if watching is None and solving is None else ""
        state = (watching and watching.id, solving and solving.id, other and other.id, fault, known)
        if state != self._state:
            self._state = state
            self._rebuild(known, watching, solving)
            with self._bar:
                if fault:
                    light("bad", fault)
                if other is not None and other.arguments.get("record"):
                    job_line(studio, other)
        self._show_tiles(watching is not None)
        if watching is not None and studio.watch.status:
            words = studio.watch.status["words"]
            self._words.set_text(words[:1].upper() + words[1:])
            self._why.set_text(f"recording {studio.watch.status['record']}: {studio.watch.status['seconds']:.0f} s")
        report = None if solving is None else studio.jobs.report(solving.id).without_time
        if solving is not None and report != self._solving:
            self._bar.clear()
            with self._bar:
                job_line(studio, solving)
        self._solving = report
        self._show_graph(known, watching is not None)
        if self._sound and self._words.text != self._said:
            say_aloud(self._words.text, good=bool(studio.watch.status.get("enough")) or "verified" in self._words.text)
        self._said = self._words.text

    def _is_mine(self, job: Job) -> bool:
        """Whether a recording or a calculation belongs to this project."""
        return self._project.name == job.arguments.get("project") or self._project.folder == job.arguments.get("folder")

    def _fault(self, known: Known) -> str:
        """Why the newest recording or calculation did not work; empty where it did."""
        newest = next((one for one in self._studio.jobs.all() if one.work in (WATCH, "calibrate") and self._is_mine(one)), None)
        if newest is None:
            return ""
        report, recording = self._studio.jobs.report(newest.id), newest.arguments.get("record")
        if report.state == "done" and recording and recording not in known.recordings.values():
            return f"{recording}: stopped before enough was seen; the earlier result stays"
        return f"{newest.title}: {report.error}" if report.state in ("failed", "lost") else ""

    def _rebuild(self, known: Known, watching: Job | None, solving: Job | None) -> None:
        step = next_step(self._project, known)
        self._bar.clear()
        if watching is not None:
            self._words.set_text("Opening the cameras")
            self._why.set_text("")
            with self._bar:
                stop = ui.button("Stop recording", icon="stop", on_click=lambda: self._studio.jobs.cancel(watching.id))
                stop.props("unelevated no-caps color=negative").classes("self-start")
        elif solving is None:
            self._words.set_text(step.words[:1].upper() + step.words[1:])
            self._why.set_text(step.why)
            self._buttons(step)
        else:
            self._words.set_text("Calculating")
            self._why.set_text("")
        self._lights.clear()
        with self._lights, card("Cameras"):
            lights_table(self._project, known)
        self._steps.clear()
        with self._steps:
            if known.recordings and watching is None and solving is None:
                steps_table(self._project, known, self._record, self._solve)
        self._show_results(known)

    def _buttons(self, step: Next) -> None:
        text, icon = ("Verify", "verified") if (step.action, step.step) == ("solve", "verify") else _BUTTONS[step.action]
        if step.back:
            text = f"{TITLES[step.step]}: record again"
        with self._bar, ui.row().classes("gap-3 items-center"):
            ui.button(text, icon=icon, on_click=lambda: self._act(step)).props("unelevated no-caps size=lg")
            if step.action == "solve":
                ui.button("Record again", icon="fiber_manual_record", on_click=lambda: self._record(step.step)).props(
                    "flat no-caps"
                )
            for earlier in step.back:
                again = ui.button(f"{TITLES[earlier]}: record again", icon="undo", on_click=partial(self._record, earlier))
                again.props("outline no-caps")
            if step.action != "print":
                ui.button("Targets", icon="print", on_click=self._print).props("flat no-caps")

    async def _act(self, step: Next) -> None:
        if step.action == "print":
            await self._print()
        elif step.action == "record":
            self._record(step.step)
        elif step.action == "solve":
            self._solve(step.step)
        elif step.action == "use":
            self._use()

    async def _print(self) -> None:
        chosen = await print_dialog(self._studio, self._project)
        if chosen is not None:
            self._project = chosen
            save_project(self._studio.workspace, chosen)
            self._state = None
            self._refresh()

    def _record(self, step: Step) -> None:
        name = new_recording(self._studio.workspace, self._project, step)
        arguments = {
            "setup": self._project.setup, "target": self._project.target(step), "record": name, "project": self._project.name,
            "step": step, "lenses": step == "extrinsics" and not self._project.lenses,
        }  # fmt: skip
        try:
            self._studio.jobs.free_cameras()
            self._studio.jobs.start(WATCH, f"Recording {name}", arguments, page="/calibrate")
        except PosefuseError as error:
            refused(error)

    def _solve(self, step: Step) -> None:
        if self._studio.jobs.running("calibrate"):
            # pressed twice
            return
        known = known_of(self._studio.workspace, self._project, tuple(self._setup.sources))
        arguments = {
            "step": step,
            "lenses": step == "extrinsics" and not self._project.lenses,
            "folder": self._project.folder,
            "recording": known.recordings[step],
            "target": self._project.target(step),
        }
        self._studio.jobs.start("calibrate", f"Calibration {self._project.name}: {step}", arguments, page="/calibrate")

    def _use(self) -> None:
        changed = Setup(name=self._setup.name, sources=self._setup.sources, rig=f"{self._project.folder}/{RIG}")
        save_setup(self._studio.workspace, changed)
        ui.notify(f"{changed.name} uses this rig now", type="positive")
        ui.navigate.to("/live")

    def _show_tiles(self, watching: bool) -> None:
        """Apart from the buttons: one that is replaced while it is pressed does nothing."""
        cameras: Mapping[str, Any] = self._studio.watch.status.get("cameras", {}) if watching else {}
        sizes = {name: one["size_wh"] for name, one in cameras.items()}
        if sizes == self._tiled:
            return
        self._tiled = sizes
        self._tiles.clear()
        if not cameras:
            return
        with self._tiles, card("Covered so far: red is poor, green is rich"), ui.element("div").classes("pf-grid"):
            for number, (name, one) in enumerate(cameras.items()):
                width, height = one["size_wh"] or (4, 3)
                with ui.column().classes("pf-tile-box"):
                    CameraTile(WATCH, number, aspect=width / height, name=name)
                    ui.label(name).classes("pf-small")

    def _show_results(self, known: Known) -> None:
        self._results.clear()
        with self._results:
            if "extrinsics" in known.results and known.results["extrinsics"]["passed"]:
                try:
                    rig = read_rig(self._studio.workspace.existing(f"{self._project.folder}/{RIG}"))
                    self._scene(rig, known.results["extrinsics"])
                except PosefuseError as error:
                    light("bad", str(error))
            with ui.element("div").classes("pf-column"):
                for step in ("verify", "extrinsics", "intrinsics"):
                    if step in known.results:
                        result_card(self._studio, step, known, self._project.folder)

    def _show_graph(self, known: Known, watching: bool) -> None:
        """As it is now while cameras are recorded, else of the newest recording in which they must be linked."""
        seen = known.coverage.get("extrinsics") or known.coverage.get("verify") or {}
        cameras, together = list(seen.get("cameras", ())), seen.get("together")
        if watching and self._studio.watch.status.get("target"):
            cameras, together = list(self._studio.watch.status["cameras"]), self._studio.watch.status["together"]
        if (cameras, together) == self._linked:
            return
        self._linked = (cameras, together)
        self._graph.clear()
        if together and len(cameras) > 1:
            with self._graph:
                graph_card(cameras, together)

    def _scene(self, rig: Rig, result: Mapping[str, Any]) -> None:
        name = f"rig-{self._project.name}"
        cov = {camera: np.asarray(one) * _LARGER**2 for camera, one in result.get("position_cov_m2", {}).items()}
        self._studio.stream(name).publish("setup", setup_message(scene_setup(rig, centre_cov=cov)), keep=True)
        with card("The rig"):
            with ui.element("div").classes("pf-stage"):
                RigScene(name)
            reference = [camera for camera in rig.names if not np.any(cov.get(camera, 0.0))]
            against = f", against {', '.join(reference)}" if reference else ""
            ui.label(f"Ellipsoids: errors of positions{against}, two standard deviations, {_LARGER:.0f} times larger.").classes(
                "pf-small"
            )
            if result.get("world"):
                light("good", f"origin and floor {result['world']}")
            else:
                light("doubt", _NO_FLOOR)
