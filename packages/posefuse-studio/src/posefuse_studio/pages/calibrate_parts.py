"""Panels of the calibration page: lights, results with their causes and remedies, printing, sound."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any
from urllib.parse import quote

import numpy as np
from nicegui import ui

from posefuse.calibration.targets.coverage import ENOUGH_TOGETHER
from posefuse.calibration.targets.printing import PAGES_M
from posefuse.core import PosefuseError
from posefuse_studio.calibrations import LIGHTS, RESTS, Known, Project, Step, blamed_cameras, lights, step_light
from posefuse_studio.camera_graph import graph_svg
from posefuse_studio.shell import card, light, refused
from posefuse_studio.state import Studio
from posefuse_studio.targets import FLOOR_ID, board_of, check_target, print_board, print_cube, targets

_REPORTS = {"intrinsics": "lenses.html", "extrinsics": "rig.html", "verify": "verified.html"}
TITLES: Mapping[Step, str] = {"intrinsics": "Lenses", "extrinsics": "Positions", "verify": "Verification"}
_FULL_COUNT = 12


def lights_table(project: Project, known: Known) -> None:
    """A row per camera, a light per thing that must be known."""
    columns = f"auto repeat({len(LIGHTS)}, minmax(max-content, 1fr))"
    with ui.element("div").classes("pf-lights").style(f"grid-template-columns: {columns}"):
        ui.label("")
        for name in LIGHTS:
            ui.label(name).classes("pf-small")
        for camera, row in lights(project, known).items():
            ui.label(camera).classes("pf-h2")
            for name in LIGHTS:
                light(row[name].state, row[name].text)


def steps_table(project: Project, known: Known, record: Callable[[Step], None], solve: Callable[[Step], None]) -> None:
    """A row per step: how far it is, what rests on it, and buttons to do it again."""
    with card("Steps"):
        for step in project.steps:
            with ui.column().classes("gap-0 w-full"):
                with ui.row().classes("items-center gap-3 w-full"):
                    ui.label(TITLES[step]).classes("pf-h2 w-28")
                    one = step_light(step, project, known)
                    light(one.state, one.text)
                    if step in known.recordings or step in known.results:
                        ui.button("Record again", on_click=partial(record, step)).props("flat dense no-caps")
                    if step in known.results and known.can_solve(step, project):
                        ui.button("Calculate again", on_click=partial(solve, step)).props("flat dense no-caps")
                ui.label(RESTS[step]).classes("pf-small")


def result_card(studio: Studio, step: Step, known: Known, folder: str) -> None:
    """Checks of a step: those that fail first, each with cause, remedy and an image."""
    result, coverage = known.results[step], known.coverage.get(step)
    checks = [(one["subject"], check) for one in result["reports"] for check in one["checks"]]
    bad = [(subject, check) for subject, check in checks if not check["passed"]]
    with card(TITLES[step]) as head:
        for subject, check in bad:
            with ui.column().classes("pf-refusal"):
                light("bad", f"{subject}: {check['name']}")
                ui.label(check["detail"])
                if check["remedy"]:
                    with ui.row().classes("items-start gap-2 no-wrap"):
                        ui.icon("build").classes("text-primary")
                        ui.label(check["remedy"]).classes("font-medium")
                _refusal_picture({**check, "subject": subject}, result.get("pictures", {}), coverage)
        for numbers in (one["numbers"] for one in result["reports"]):
            if step == "verify" and "length_rms_mm" in numbers:
                ui.label(
                    f"{numbers['length_rms_mm']:.1f} mm rms error of {numbers['lengths']:.0f} lengths on the board;"
                    f" they measure {numbers['scale']:.4f} of the truth"
                )
        if "cells" in result:
            _coverage(result["cells"])
        with ui.expansion(f"{len(checks) - len(bad)} checks passed", icon="checklist").classes("w-full"):
            for subject, check in checks:
                if check["passed"]:
                    light("good", f"{subject}: {check['name']}")
                    ui.label(check["detail"]).classes("pf-small")
    with head:
        ui.space()
        word = "passed" if result["passed"] else "refused"
        if known.passed(step) or known.refused(step):
            light("good" if result["passed"] else "bad", word)
        else:
            light("doubt", f"{word}, an earlier one")
        report = f"{folder}/{_REPORTS[step]}"
        if studio.workspace.path(report).is_file():
            ui.link("Report", f"/studio/file?name={quote(report)}", new_tab=True)


def _refusal_picture(check: Mapping[str, Any], pictures: Mapping[str, str], coverage: Mapping[str, Any] | None) -> None:
    """Images of the cameras that a check names; where it names none, how the cameras are linked."""
    named = [camera for camera in blamed_cameras(check, tuple(pictures)) if camera in pictures]
    if not named and coverage and coverage.get("together"):
        graph(coverage["cameras"], coverage["together"])
        return
    with ui.element("div").classes("pf-grid"):
        for camera in named:
            image = ui.image(f"/studio/file?name={quote(pictures[camera])}").classes("pf-refused").props("no-spinner fit=contain")
            image.props["alt"] = f"what {camera} saw, with the target as it was found"


def graph_card(cameras: Sequence[str], together: Sequence[Sequence[int]]) -> None:
    """Which cameras share views of the target, and how often."""
    with card("Which cameras share views"):
        graph(cameras, together)
        ui.label(
            f"Moments at which two cameras saw the target at once. Green: {ENOUGH_TOGETHER} or more, which is enough; all cameras"
            " must hang together by green lines."
        ).classes("pf-small")


def graph(cameras: Sequence[str], together: Sequence[Sequence[int]]) -> None:
    """The drawing alone."""
    ui.html(graph_svg(cameras, together), sanitize=False).classes("w-full flex justify-center")


def _coverage(cells: Mapping[str, Any]) -> None:
    """A small grid per image: which parts the target has met, the more often the stronger."""
    with ui.row().classes("gap-4"):
        for camera, counts in cells.items():
            level = np.clip(np.asarray(counts, float) / _FULL_COUNT, 0, 1)
            rows, columns = level.shape
            boxes = "".join(
                f'<rect x="{x}" y="{y}" width=".94" height=".94" rx=".12" opacity="{0.1 + 0.9 * level[y, x]:.2f}"/>'
                for y in range(rows)
                for x in range(columns)
            )
            with ui.column().classes("gap-1"):
                drawn = f'<svg viewBox="0 0 {columns} {rows}" width="120" fill="currentColor" aria-hidden="true">{boxes}</svg>'
                ui.html(drawn, sanitize=False).classes("text-primary")
                ui.label(f"{camera}: {float((level > 0).mean()):.0%}").classes("pf-small")


async def print_dialog(studio: Studio, project: Project) -> Project | None:
    """Make or choose the targets; None where nothing was chosen."""
    lenses: Step = "intrinsics" if project.lenses else "verify"
    with ui.dialog() as dialog, ui.card().classes("gap-3"):
        ui.label("Targets").classes("pf-h2")
        page = ui.select(list(PAGES_M), value="a4", label="Paper").classes("w-32")
        with ui.row().classes("items-end gap-3"):
            marker = ui.number("Cube: black square, mm", value=120, min=20, max=500).classes("w-44")
        with ui.row().classes("items-end gap-3"):
            columns = ui.number("Board: squares across", value=5, min=3, max=30, precision=0).classes("w-40")
            rows = ui.number("down", value=7, min=3, max=30, precision=0).classes("w-20")
            square = ui.number("square, mm", value=36, min=5, max=300).classes("w-28")
        made = ui.column().classes("gap-1")

        async def make() -> None:
            try:
                sheet = str(page.value)
                across, down, side_mm = int(columns.value), int(rows.value), float(square.value)
                check_target(board_of(columns=across, rows=down, square_mm=side_mm), lenses)
                cube = await asyncio.to_thread(print_cube, studio.workspace, marker_mm=float(marker.value), page=sheet)
                board = await asyncio.to_thread(
                    print_board, studio.workspace, columns=across, rows=down, square_mm=side_mm, page=sheet
                )
            except (PosefuseError, TypeError) as error:
                refused(error)
                return
            cubes.set_options(targets(studio.workspace, "extrinsics"), value=cube.target)
            boards.set_options(targets(studio.workspace, lenses), value=board.target)
            with made:
                ui.link(f"Open {cube.pdf}", f"/studio/file?name={quote(cube.pdf)}", new_tab=True)
                ui.link(f"Open {board.pdf}", f"/studio/file?name={quote(board.pdf)}", new_tab=True)
                ui.label(f"Print at 100 %, then measure the ruler on the sheet. Marker {FLOOR_ID} is for the floor.").classes(
                    "pf-small"
                )

        ui.button("Make PDF files", icon="picture_as_pdf", on_click=make).props("outline no-caps")
        cubes = _target_choice(targets(studio.workspace, "extrinsics"), project.cube, "Cube in use")
        boards = _target_choice(targets(studio.workspace, lenses), project.board, "Board in use")

        def use() -> None:
            if cubes.value and boards.value:
                dialog.submit(replace(project, cube=str(cubes.value), board=str(boards.value)))
            else:
                ui.notify("Choose a cube and a board; Make PDF files makes both", type="warning")

        with ui.row().classes("w-full justify-end"):
            ui.button("Use these", on_click=use).props("unelevated no-caps")
    chosen: Project | None = await dialog
    return chosen


def _target_choice(names: Sequence[str], now: str, label: str) -> ui.select:
    return ui.select(list(names), value=now if now in names else None, label=label).classes("w-72")


def say_aloud(words: str, *, good: bool) -> None:
    """Two tones (rising where something is complete), and the words in a voice of the user's own machine where it has one."""
    tones = [523, 659, 784] if good else [659, 523]
    ui.run_javascript(_SOUND % (json.dumps(tones), json.dumps(words)))


# voices of other hosts would send the words away
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
const voice = window.speechSynthesis?.getVoices().find((one) => one.localService && one.lang.startsWith("en"));
if (voice) {
  const words = new SpeechSynthesisUtterance(%s);
  words.voice = voice;
  speechSynthesis.cancel();
  speechSynthesis.speak(words);
}
"""
