"""Calibrate: from cameras to a verified rig, one thing at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
from nicegui import ui

import posefuse as pf
from posefuse.calibration.settings import PAGES_M
from posefuse.core import InputError, PosefuseError
from posefuse_studio.calibrations import (
    FLOOR_ID,
    FOLDER,
    RIG,
    STEPS,
    Action,
    Known,
    Next,
    Project,
    Step,
    StepResult,
    known_of,
    new_recording,
    print_targets,
    projects,
    save_project,
    stamp,
    targets,
)
from posefuse_studio.jobs import WATCH, Job, Report
from posefuse_studio.scene import RigScene
from posefuse_studio.scene_messages import setup_message
from posefuse_studio.setups import Setup, presets, save_setup, setup_named
from posefuse_studio.shell import (
    camera_tiles,
    card,
    dialog,
    file_address,
    job_lines,
    light,
    redrawn,
    show_summary,
    small,
    title,
)
from posefuse_studio.state import Studio

# errors of millimetres would not be seen in a room
_LARGER = 50.0
_NO_FLOOR = (
    f"No marker {FLOOR_ID} was seen on the floor: up is estimated from the cameras, and the height of the floor is not known. Lay"
    " it down and record again, so that people stand on the floor."
)
# of the targets to print: setting, words, usual value
_SIZES = (
    ("marker_mm", "Cube: square, mm", 120),
    ("columns", "Board: squares across", 5),
    ("rows", "down", 7),
    ("square_mm", "square, mm", 36),
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
    stream = studio.page_stream(ui.context.client)
    chooser, place = ui.row().classes("items-center gap-3"), ui.column().classes("pf-column w-full")

    def show(name: str) -> None:
        found = projects(studio.workspace)
        chooser.clear()
        with chooser:
            if found:
                select = ui.select(sorted(found), value=name, label="Calibration", on_change=lambda event: show(event.value))
                select.classes("w-56")
            ui.button("New calibration", icon="add", on_click=lambda: _new(studio, show)).props("outline")
        place.clear()
        with place:
            if name not in found:
                _notice(
                    "Choose the cameras to calibrate",
                    "A calibration belongs to a preset of the page Cameras, and can be repeated at any time.",
                )
            elif (setup := found[name].setup) not in presets(studio.workspace):
                _notice(
                    f"The preset {setup} is missing",
                    f"The calibration {name} belongs to these cameras. Save them under this name again on the page Cameras, or"
                    " begin a new calibration.",
                )
            else:
                _Guide(studio, found[name], stream).build()

    # what was worked on last
    show(next(iter(projects(studio.workspace)), ""))


def _notice(words: str, about: str) -> None:
    with card():
        ui.label(words).classes("pf-next")
        ui.label(about).classes("pf-about")


def _new(studio: Studio, show: Callable[[str], None]) -> None:
    names = presets(studio.workspace)
    if not names:
        ui.notify("First name and save the cameras on the page Cameras", type="warning")
        return

    def begin() -> None:
        project = Project(name=name.value.strip(), setup=setup.value)
        if project.name in projects(studio.workspace):
            raise InputError(f"{project.name}: there is a calibration of this name; each of its steps can be done again")
        save_project(studio.workspace, project)
        show(project.name)

    with dialog("New calibration", {"Begin": begin}):
        name = ui.input("Name", value=studio.workspace.free_name(FOLDER, "room").rpartition("/")[2]).classes("w-64")
        setup = ui.select(names, value=names[-1], label="Cameras").classes("w-64")


class _Guide:
    """One project as one visitor sees it."""

    def __init__(self, studio: Studio, project: Project, stream: str) -> None:
        self._studio, self._project, self._stream = studio, project, stream
        self._setup = setup_named(studio.workspace, project.setup)
        self._read: tuple[object, Known] = None, Known(project=project)

    def build(self) -> None:
        """Place it, and keep it as the files are."""
        with card("What to do next") as head:
            with head:
                # heard at once when it is switched on: so the user knows that it works
                self._sound = ui.switch("Sound", on_change=lambda: self._show_instruction(self._instruction()[0]))
            self._words = ui.label("").classes("pf-next").props('role="status" aria-live="polite"')
            redrawn(lambda: self._instruction()[1], lambda why: ui.label(why).classes("pf-about"))
            redrawn(lambda: (self._known, *self._jobs()), lambda _: self._show_work(), classes="w-full gap-2")
            job_lines(self._studio, self._concerns, most=1)
        redrawn(self._sizes, self._show_tiles)
        with ui.element("div").classes("pf-halves"):
            redrawn(lambda: self._known["extrinsics"].result, self._show_rig)
            redrawn(lambda: (self._known, any(self._jobs())), self._show_steps, classes="pf-column")
        redrawn(lambda: self._instruction()[0], self._show_instruction)

    @property
    def _known(self) -> Known:
        """What there is, read again when a file has changed."""
        workspace, project = self._studio.workspace, self._project
        now = stamp(workspace, project), project
        if now != self._read[0]:
            self._read = now, known_of(workspace, project)
        return self._read[1]

    def _mine(self, job: Job | None) -> bool:
        """Whether a recording or a calculation belongs to this project."""
        return job is not None and job.arguments.get("folder") == self._project.folder

    def _jobs(self) -> tuple[Job | None, Job | None]:
        """The recording and the calculation that run."""
        recording = self._studio.watch.job
        solving = next(filter(self._mine, self._studio.jobs.running("calibrate")), None)
        return recording if self._mine(recording) else None, solving

    def _sizes(self) -> dict[str, object]:
        """Of the images of the cameras that are recorded for this project."""
        cameras = self._studio.watch.status.cameras if self._jobs()[0] else {}
        return {name: one.size_wh for name, one in cameras.items()}

    def _concerns(self, job: Job, report: Report) -> bool:
        """Whether it is the newest work of this project, also one that has failed, or what else needs the cameras."""
        if self._mine(job):
            # a recording that runs is in the lines above, with a button
            return job.work == "calibrate" or (job.work == WATCH and report.ended)
        return job.work == WATCH and bool(job.arguments.get("record")) and not report.ended

    def _show_work(self) -> None:
        recording, solving = self._jobs()
        if recording is not None:
            stop = ui.button("Stop recording", icon="stop", on_click=lambda: self._studio.jobs.cancel(recording.id))
            stop.props("unelevated color=negative")
        elif solving is None:
            self._buttons(self._known.next_step())

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

    def _show_instruction(self, text: str) -> None:
        """With tones, where they are wanted."""
        self._words.set_text(text[:1].upper() + text[1:])
        if self._sound.value:
            sound(good=self._studio.watch.status.enough or "verified" in text)

    def _buttons(self, step: Next) -> None:
        text, icon = ("Verify", "verified") if (step.action, step.step) == ("solve", "verify") else _BUTTONS[step.action]
        if step.action == "record" and self._known[step.step].result is not None:
            text = f"{TITLES[step.step]}: record again"
        record, solve = partial(self._record, step.step), partial(self._solve, step.step)
        acts: dict[Action, Callable[[], None]] = {"print": self._print, "use": self._use, "record": record, "solve": solve}
        with ui.row().classes("gap-3 items-center"):
            ui.button(text, icon=icon, on_click=acts[step.action]).props("unelevated size=lg")
            if step.action == "solve":
                ui.button("Record again", icon="fiber_manual_record", on_click=record).props("flat")
            if step.action != "print":
                ui.button("Targets", icon="print", on_click=self._print).props("flat")

    def _print(self) -> None:
        """Make or choose the targets."""
        workspace = self._studio.workspace

        async def make() -> None:
            given = {name: field.value for name, field in sizes.items() if field.value is not None}
            cube, board = await asyncio.to_thread(print_targets, workspace, given, str(page.value))
            cubes.set_options(targets(workspace, "extrinsics"), value=cube)
            boards.set_options(targets(workspace, "intrinsics"), value=board)
            with made:
                for name in (cube, board):
                    pdf = name.replace(".toml", ".pdf")
                    ui.link(f"Open {pdf}", file_address(pdf), new_tab=True)
                small(f"Print at 100 %, then measure the ruler on the sheet. Marker {FLOOR_ID} is for the floor.")

        def use() -> None:
            if not (cubes.value and boards.value):
                raise InputError("Choose a cube and a board; Make PDF files makes both")
            self._project = replace(self._project, cube=str(cubes.value), board=str(boards.value))
            save_project(workspace, self._project)

        def choice(label: str, step: Step) -> ui.select:
            names, now = targets(workspace, step), self._project.target(step)
            return ui.select(names, value=now if now in names else None, label=label).classes("w-72")

        with dialog("Targets", {"Use these": use}):
            page = ui.select(list(PAGES_M), value="a4", label="Paper").classes("w-32")
            with ui.row().classes("items-end gap-3"):
                sizes = {name: ui.number(text, value=value, min=1).classes("pf-number") for name, text, value in _SIZES}
            made = ui.column().classes("gap-1")
            ui.button("Make PDF files", icon="picture_as_pdf", on_click=make).props("outline")
            cubes, boards = choice("Cube in use", "extrinsics"), choice("Board in use", "intrinsics")

    def _start(self, work: str, text: str, step: Step, **more: object) -> None:
        project = self._project
        arguments = {"folder": project.folder, "step": step, "target": project.target(step), **more}
        self._studio.jobs.start(work, text, arguments)

    def _record(self, step: Step) -> None:
        name = new_recording(self._studio.workspace, self._project, step)
        self._start(WATCH, f"Recording {name}", step, record=name, sources=dict(self._setup.sources))

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

    def _show_tiles(self, sizes: Mapping[str, object]) -> None:
        if sizes:
            with card("Covered so far: red is poor, green is rich"):
                camera_tiles(self._studio.watch, WATCH)

    def _show_rig(self, placed: StepResult | None) -> None:
        if placed is None or not placed.passed:
            return
        try:
            rig = pf.read_rig(self._studio.workspace.existing(f"{self._project.folder}/{RIG}"))
        except PosefuseError as error:
            light("bad", self._studio.workspace.in_names(str(error)))
            return
        cov = {camera: np.asarray(one) * _LARGER**2 for camera, one in placed.position_cov_m2.items()}
        self._studio.streams[self._stream].publish("setup", setup_message(rig, centre_cov=cov), keep=True)
        with card("The rig"):
            with ui.element("div").classes("pf-stage"):
                RigScene(self._stream)
            reference = [camera for camera in rig.names if not np.any(cov.get(camera, 0.0))]
            against = f", against {', '.join(reference)}" if reference else ""
            small(f"Ellipsoids: errors of positions{against}, two standard deviations, {_LARGER:.0f} times larger.")
            if placed.world:
                light("good", f"origin and floor {placed.world}")
            else:
                light("doubt", _NO_FLOOR)

    def _show_steps(self, state: tuple[Known, bool]) -> None:
        known, busy = state
        for step in STEPS:
            if known[step].recording or known[step].result is not None:
                with card(TITLES[step]) as head:
                    show_step(step, known)
                with head:
                    self._step_head(step, known, busy=busy)

    def _step_head(self, step: Step, known: Known, *, busy: bool) -> None:
        """How far it is, its report, and buttons to do it again."""
        report = f"{known.project.folder}/{_REPORTS[step]}"
        light(*known.step_light(step))
        if self._studio.workspace.path(report).is_file():
            ui.link("Report", file_address(report), new_tab=True)
        if not busy:
            ui.button("Record again", on_click=partial(self._record, step)).props("flat dense")
            if known[step].result is not None and known.can_solve(step):
                ui.button("Calculate again", on_click=partial(self._solve, step)).props("flat dense")


TITLES: Mapping[Step, str] = {"intrinsics": "Intrinsics", "extrinsics": "Extrinsics", "verify": "Verification"}
_RESTS: Mapping[Step, str] = {
    "intrinsics": "Positions and verification rest on it: after new lenses, they are calculated again.",
    "extrinsics": "The verification rests on it: after new positions, it is recorded again.",
    "verify": "Nothing rests on it: repeat it whenever a camera may have been touched.",
}
_REPORTS = {"intrinsics": "lenses.html", "extrinsics": "rig.html", "verify": "verified.html"}


def show_step(step: Step, known: Known) -> None:
    """What rests on a step and what it has given: checks that fail first, each with cause and remedy."""
    small(_RESTS[step])
    state = known[step]
    result = state.result
    if result is None:
        return
    if state.current is None:
        light("doubt", "these results are of an earlier recording, or rest on earlier lenses or positions")
    for subject, check in result.failed:
        with ui.column().classes("pf-refusal"):
            light("bad", f"{subject}: {check.name}")
            ui.label(check.detail)
            if check.remedy:
                with ui.row().classes("items-start gap-2 no-wrap"):
                    ui.icon("build").classes("text-primary")
                    ui.label(check.remedy).classes("font-medium")
    for numbers in (report.numbers for report in result.reports):
        if step == "verify" and "length_rms_mm" in numbers:
            ui.label(
                f"{numbers['length_rms_mm']:.1f} mm rms error of {numbers['lengths']:.0f} lengths on the board;"
                f" they measure {numbers['scale']:.4f} of the truth"
            )
    good = sum(check.passed for report in result.reports for check in report.checks)
    with ui.expansion(f"{good} checks passed", icon="checklist").classes("w-full"):
        for report in result.reports:
            show_summary(report.summary())


def sound(*, good: bool) -> None:
    """Two tones; three, rising, where something is complete."""
    ui.run_javascript(_SOUND % ([523, 659, 784] if good else [659, 523]))


_SOUND = """
const context = window.posefuseSound ||= new AudioContext();
%s.forEach((hertz, i) => {
  const tone = context.createOscillator(), volume = context.createGain(), at = context.currentTime + 0.17 * i;
  tone.frequency.value = hertz;
  volume.gain.setValueAtTime(0.15, at);
  volume.gain.exponentialRampToValueAtTime(0.001, at + 0.16);
  tone.connect(volume).connect(context.destination);
  tone.start(at);
  tone.stop(at + 0.17);
});
"""
