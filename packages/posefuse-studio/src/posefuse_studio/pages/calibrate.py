"""Calibrate: from cameras to a verified rig, one thing at a time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from nicegui import ui

import posefuse as pf
from posefuse.core import InputError, PosefuseError
from posefuse_studio.calibrations import (
    FOLDER,
    RIG,
    Action,
    Known,
    Next,
    Project,
    Step,
    StepResult,
    known_of,
    new_recording,
    projects,
    save_project,
    stamp,
)
from posefuse_studio.jobs import WATCH, Job
from posefuse_studio.pages.calibrate_parts import (
    TITLES,
    graph_card,
    lights_table,
    print_dialog,
    result_card,
    sound,
    steps_table,
)
from posefuse_studio.pages.camera_tiles import camera_tiles
from posefuse_studio.scene.messages import setup_message
from posefuse_studio.scene.setup import scene_setup
from posefuse_studio.scene.view import RigScene
from posefuse_studio.session import CameraStatus
from posefuse_studio.setups import DEMO, Setup, save_setup, setup_named, setups
from posefuse_studio.shell import card, dialog, job_line, light, redrawn, refusals, small, title
from posefuse_studio.state import Studio
from posefuse_studio.targets import FLOOR_ID

# errors of millimetres would not be seen in a room
_LARGER = 50.0
_NO_FLOOR = (
    f"No marker {FLOOR_ID} was seen on the floor: up is estimated from the cameras, and the height of the floor is not known. Lay"
    " it down and record again, so that people stand on the floor."
)
_BUTTONS = {
    "print": ("Print targets", "print"),
    "record": ("Start recording", "fiber_manual_record"),
    "solve": ("Calibrate", "play_arrow"),
    "use": ("Use this rig", "check"),
}


def build(studio: Studio) -> None:
    """Place the page."""
    title("Calibrate", "Where the cameras stand, how their lenses draw, and how far all of it can be trusted.")
    chooser, place = ui.row().classes("items-center gap-3"), ui.column().classes("pf-column w-full")

    def show(name: str) -> None:
        found = projects(studio.workspace)
        chooser.clear()
        with chooser:
            if found:
                ui.select(sorted(found), value=name, label="Calibration", on_change=lambda event: show(event.value)).classes(
                    "w-56"
                )
            ui.button("New", icon="add", on_click=lambda: _new(studio, show)).props("outline")
        place.clear()
        with place:
            if name not in found:
                _welcome(studio, show)
            elif found[name].setup not in {one.name for one in setups(studio.workspace)}:
                _without_cameras(found[name])
            else:
                _Guide(studio, found[name]).build()

    # what was worked on last
    show(next(iter(projects(studio.workspace)), ""))


def _welcome(studio: Studio, show: Callable[[str], None]) -> None:
    with card():
        ui.label("Choose the cameras to calibrate").classes("pf-next")
        ui.label("A calibration belongs to a preset of the page Cameras, and can be repeated at any time.").classes("pf-about")
        ui.button("New calibration", icon="add", on_click=lambda: _new(studio, show)).props("unelevated size=lg")


def _without_cameras(project: Project) -> None:
    with card():
        ui.label(f"The preset {project.setup} is missing").classes("pf-next")
        ui.label(
            f"The calibration {project.name} belongs to these cameras. Save them under this name again on the page Cameras, or"
            " begin a new calibration."
        ).classes("pf-about")


def _new(studio: Studio, show: Callable[[str], None]) -> None:
    names = [one.name for one in setups(studio.workspace) if one.name != DEMO]
    if not names:
        ui.notify("First name and save the cameras on the page Cameras", type="warning")
        return

    def begin() -> None:
        project = Project(name=name.value.strip(), setup=setup.value, lenses=lenses.value)
        if project.name in projects(studio.workspace):
            raise InputError(f"{project.name}: there is a calibration of this name; each of its steps can be done again")
        save_project(studio.workspace, project)
        show(project.name)

    with dialog("New calibration", {"Begin": begin}):
        name = ui.input("Name", value=studio.workspace.free_name(FOLDER, "room").rpartition("/")[2]).classes("w-64")
        setup = ui.select(names, value=names[-1], label="Cameras").classes("w-64")
        lenses = ui.checkbox("Calibrate the lenses first (more exact)", value=True)


class _Guide:
    """One project as one visitor sees it."""

    def __init__(self, studio: Studio, project: Project) -> None:
        self._studio, self._project = studio, project
        self._setup = setup_named(studio.workspace, project.setup)
        self._heard = ""
        self._read: tuple[object, Known] = None, Known(project=project, cameras=())

    def build(self) -> None:
        """Place it, and keep it as the files are."""
        with card("What to do next") as head:
            with head:
                # heard at once when it is switched on: so the user knows that it works
                self._sound = ui.switch("Sound", on_change=lambda: self._sound_news(again=True))
            self._words = ui.label("").classes("pf-next").props('role="status" aria-live="polite"')
            self._why = ui.label("").classes("pf-about")
            redrawn(self._work, self._show_work, classes="w-full gap-2")
        redrawn(lambda: {name: one.size_wh for name, one in self._watched().items()}, lambda _: self._show_tiles())
        redrawn(lambda: (self._known, any(self._jobs())), lambda _: self._show_known())
        redrawn(self._linked, lambda linked: graph_card(*linked) if linked[1] and len(linked[0]) > 1 else None)
        redrawn(lambda: self._known, self._show_results, classes="pf-halves")
        redrawn(self._instruction, self._show_instruction)

    @property
    def _known(self) -> Known:
        """What there is, read again when a file has changed."""
        workspace, project = self._studio.workspace, self._project
        now = stamp(workspace, project), project
        if now != self._read[0]:
            self._read = now, known_of(workspace, project, tuple(self._setup.sources))
        return self._read[1]

    def _mine(self, job: Job | None) -> bool:
        """Whether a recording or a calculation belongs to this project."""
        return job is not None and job.arguments.get("folder") == self._project.folder

    def _jobs(self) -> tuple[Job | None, Job | None]:
        """The recording and the calculation that run."""
        recording = self._studio.watch.job
        solving = next(filter(self._mine, self._studio.jobs.running("calibrate")), None)
        return recording if self._mine(recording) else None, solving

    def _watched(self) -> dict[str, CameraStatus]:
        return dict(self._studio.watch.status.cameras) if self._jobs()[0] else {}

    def _work(self) -> tuple[object, ...]:
        """What the buttons depend on."""
        recording, solving = self._jobs()
        other = self._studio.watch.job if recording is None else None
        report = solving and self._studio.jobs.report(solving.id).without_time
        return self._known, recording, solving, report, other if other and other.arguments.get("record") else None

    def _show_work(self, state: tuple[object, ...]) -> None:
        recording, solving = self._jobs()
        jobs = self._studio.jobs
        if recording is not None:
            stop = ui.button("Stop recording", icon="stop", on_click=lambda: jobs.cancel(recording.id))
            stop.props("unelevated color=negative")
        elif solving is not None:
            job_line(self._studio, solving, jobs.report(solving.id))
        else:
            known = self._known
            self._buttons(known.next_step())
            if fault := self._fault(known):
                light("bad", fault)
            if isinstance(other := state[-1], Job):
                job_line(self._studio, other, jobs.report(other.id))

    def _fault(self, known: Known) -> str:
        """Why the newest recording or calculation did not work; empty where it did."""
        newest = next(filter(self._mine, self._studio.jobs.all(WATCH, "calibrate")), None)
        if newest is None:
            return ""
        report, recording = self._studio.jobs.report(newest.id), newest.arguments.get("record")
        if report.state == "done" and recording and recording not in [one.recording for one in known.steps.values()]:
            return f"{recording}: stopped before enough was seen; the earlier result stays"
        return f"{newest.title}: {report.error}" if report.state in ("failed", "lost") else ""

    def _instruction(self) -> tuple[str, str]:
        """What to do, in large letters, and why."""
        recording, solving = self._jobs()
        now = self._studio.watch.status
        if recording is not None:
            return now.words or "opening the cameras", f"recording {now.recording}: {now.seconds:.0f} s" if now.words else ""
        if solving is not None:
            return "calculating", ""
        step = self._known.next_step()
        return step.words, step.why

    def _show_instruction(self, state: tuple[str, str]) -> None:
        text, why = state
        self._words.set_text(text[:1].upper() + text[1:])
        self._why.set_text(why)
        self._sound_news()

    def _sound_news(self, *, again: bool = False) -> None:
        """Tones, where there is another instruction."""
        text = self._words.text
        if self._sound.value and (again or text != self._heard):
            sound(good=self._studio.watch.status.enough or "verified" in text)
        self._heard = text

    def _buttons(self, step: Next) -> None:
        text, icon = ("Verify", "verified") if (step.action, step.step) == ("solve", "verify") else _BUTTONS[step.action]
        if step.back:
            text = f"{TITLES[step.step]}: record again"
        record, solve = partial(self._record, step.step), partial(self._solve, step.step)
        acts: dict[Action, Callable[[], None]] = {"print": self._print, "use": self._use, "record": record, "solve": solve}
        with ui.row().classes("gap-3 items-center"):
            ui.button(text, icon=icon, on_click=acts[step.action]).props("unelevated size=lg")
            if step.action == "solve":
                ui.button("Record again", icon="fiber_manual_record", on_click=record).props("flat")
            for earlier in step.back:
                again = ui.button(f"{TITLES[earlier]}: record again", icon="undo", on_click=partial(self._record, earlier))
                again.props("outline")
            if step.action != "print":
                ui.button("Targets", icon="print", on_click=self._print).props("flat")

    def _print(self) -> None:
        def use(project: Project) -> None:
            save_project(self._studio.workspace, project)
            self._project = project

        print_dialog(self._studio, self._project, use)

    def _start(self, work: str, text: str, step: Step, **more: object) -> None:
        project = self._project
        lenses = step == "extrinsics" and not project.lenses
        arguments = {"folder": project.folder, "step": step, "target": project.target(step), "lenses": lenses, **more}
        with refusals():
            self._studio.jobs.start(work, text, arguments, page="/calibrate")

    def _record(self, step: Step) -> None:
        name = new_recording(self._studio.workspace, self._project, step)
        self._start(WATCH, f"Recording {name}", step, record=name, setup=self._project.setup)

    def _solve(self, step: Step) -> None:
        # unless it was pressed twice
        if not self._studio.jobs.running("calibrate"):
            text = f"Calibration {self._project.name}: {step}"
            self._start("calibrate", text, step, recording=self._known[step].recording)

    def _use(self) -> None:
        changed = Setup(name=self._setup.name, sources=self._setup.sources, rig=f"{self._project.folder}/{RIG}")
        save_setup(self._studio.workspace, changed)
        ui.notify(f"{changed.name} uses this rig now", type="positive")
        ui.navigate.to("/live")

    def _show_tiles(self) -> None:
        if self._watched():
            with card("Covered so far: red is poor, green is rich"):
                camera_tiles(self._studio.watch, WATCH)

    def _show_known(self) -> None:
        known = self._known
        with card("Cameras"):
            lights_table(known)
        if any(state.recording for state in known.steps.values()) and not any(self._jobs()):
            steps_table(known, self._record, self._solve)

    def _linked(self) -> tuple[list[str], list[list[int]]]:
        """As it is now while cameras are recorded, else of the newest recording in which they must be linked."""
        now = self._studio.watch.status
        if self._jobs()[0] and now.target:
            return list(now.cameras), now.together
        known = self._known
        seen = known["extrinsics"].seen or known["verify"].seen
        return (seen.cameras, seen.together) if seen is not None else ([], [])

    def _show_results(self, known: Known) -> None:
        placed = known["extrinsics"].result
        if placed is not None and placed.passed:
            try:
                rig = pf.read_rig(self._studio.workspace.existing(f"{self._project.folder}/{RIG}"))
            except PosefuseError as error:
                light("bad", str(error))
            else:
                self._scene(rig, placed)
        with ui.element("div").classes("pf-column"):
            for step in ("verify", "extrinsics", "intrinsics"):
                result_card(self._studio, step, known)

    def _scene(self, rig: pf.Rig, result: StepResult) -> None:
        name = f"rig-{self._project.name}"
        cov = {camera: np.asarray(one) * _LARGER**2 for camera, one in result.position_cov_m2.items()}
        self._studio.stream(name).publish("setup", setup_message(scene_setup(rig, centre_cov=cov)), keep=True)
        with card("The rig"):
            with ui.element("div").classes("pf-stage"):
                RigScene(name)
            reference = [camera for camera in rig.names if not np.any(cov.get(camera, 0.0))]
            against = f", against {', '.join(reference)}" if reference else ""
            small(f"Ellipsoids: errors of positions{against}, two standard deviations, {_LARGER:.0f} times larger.")
            if result.world:
                light("good", f"origin and floor {result.world}")
            else:
                light("doubt", _NO_FLOOR)
