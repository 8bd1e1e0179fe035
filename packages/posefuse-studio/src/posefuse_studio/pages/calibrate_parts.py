"""Panels of the calibration page: lights, results with their causes and remedies, printing, sound."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

from nicegui import ui

from posefuse.calibration.settings import TargetDescription
from posefuse.calibration.targets.coverage import ENOUGH_TOGETHER
from posefuse.calibration.targets.printing import PAGES_M
from posefuse.core import InputError
from posefuse_studio.calibrations import Known, Project, Step, named_cameras
from posefuse_studio.form import setting_fields
from posefuse_studio.shell import card, dialog, file_address, light, refusals, small
from posefuse_studio.state import Studio
from posefuse_studio.summary import show_summary
from posefuse_studio.targets import FLOOR_ID, print_targets, targets

TITLES: Mapping[Step, str] = {"intrinsics": "Lenses", "extrinsics": "Positions", "verify": "Verification"}
_RESTS: Mapping[Step, str] = {
    "intrinsics": "Positions and verification rest on it: after new lenses, they are calculated again.",
    "extrinsics": "The verification rests on it: after new positions, it is recorded again.",
    "verify": "Nothing rests on it: repeat it whenever a camera may have been touched.",
}
_REPORTS = {"intrinsics": "lenses.html", "extrinsics": "rig.html", "verify": "verified.html"}
_GOOD, _DOUBT, _BAD = "#2e9e57", "#f9a825", "#e53935"


def lights_table(known: Known) -> None:
    """A row per camera, a light per thing that must be known."""
    rows = {camera: known.lights(camera) for camera in known.cameras}
    names = list(next(iter(rows.values()), {}))
    columns = f"auto repeat({len(names)}, minmax(max-content, 1fr))"
    with ui.element("div").classes("pf-lights").style(f"grid-template-columns: {columns}"):
        for name in ("", *names):
            small(name)
        for camera, row in rows.items():
            ui.label(camera).classes("pf-h2")
            for one in row.values():
                light(one.state, one.text)


def steps_table(known: Known, record: Callable[[Step], None], solve: Callable[[Step], None]) -> None:
    """A row per step: how far it is, what rests on it, and buttons to do it again."""
    with card("Steps"):
        for step in known.project.steps:
            state, shown = known[step], known.step_light(step)
            with ui.column().classes("gap-0 w-full"):
                with ui.row().classes("items-center gap-3 w-full"):
                    ui.label(TITLES[step]).classes("pf-h2 w-28")
                    light(shown.state, shown.text)
                    if state.recording or state.result is not None:
                        ui.button("Record again", on_click=partial(record, step)).props("flat dense")
                    if state.result is not None and known.can_solve(step):
                        ui.button("Calculate again", on_click=partial(solve, step)).props("flat dense")
                small(_RESTS[step])


def result_card(studio: Studio, step: Step, known: Known) -> None:
    """What a step has given: checks that fail first, each with cause, remedy and an image; nothing where there is none."""
    state = known[step]
    result = state.result
    if result is None:
        return
    with card(TITLES[step]) as head:
        for subject, check in result.failed:
            with ui.column().classes("pf-refusal"):
                light("bad", f"{subject}: {check.name}")
                ui.label(check.detail)
                if check.remedy:
                    with ui.row().classes("items-start gap-2 no-wrap"):
                        ui.icon("build").classes("text-primary")
                        ui.label(check.remedy).classes("font-medium")
                named = named_cameras(f"{subject} {check.detail}", tuple(result.pictures))
                with ui.element("div").classes("pf-grid"):
                    for camera in named:
                        image = (
                            ui.image(file_address(result.pictures[camera])).classes("pf-refused").props("no-spinner fit=contain")
                        )
                        image.props["alt"] = f"what {camera} saw, with the target as it was found"
                if not named and state.seen is not None and state.seen.together:
                    _graph(state.seen.cameras, state.seen.together)
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
    with head:
        word = "passed" if result.passed else "refused"
        if state.current is not None:
            light("good" if result.passed else "bad", word)
        else:
            light("doubt", f"{word}, an earlier one")
        report_file = f"{known.project.folder}/{_REPORTS[step]}"
        if studio.workspace.path(report_file).is_file():
            ui.link("Report", file_address(report_file), new_tab=True)


def graph_card(cameras: Sequence[str], together: Sequence[Sequence[int]]) -> None:
    """Which cameras share views of the target, and how often."""
    with card("Which cameras share views"):
        _graph(cameras, together)
        small(
            f"Moments at which two cameras saw the target at once. Green: {ENOUGH_TOGETHER} or more, which is enough; all cameras"
            " must hang together by green lines."
        )


def shared_views(cameras: Sequence[str], together: Sequence[Sequence[int]]) -> dict[tuple[str, str], int]:
    """How many moments pairs of cameras share, of those that share any; `together` is (C, C) as in `TargetCoverage`."""
    pairs = combinations(range(len(cameras)), 2)
    return {(cameras[a], cameras[b]): int(together[a][b]) for a, b in pairs if together[a][b] > 0}


def graph_words(cameras: Sequence[str], shared: Mapping[tuple[str, str], int]) -> str:
    """The drawing in words."""
    pairs = [f"{a} and {b} {count}{', too few' * (count < ENOUGH_TOGETHER)}" for (a, b), count in shared.items()]
    alone = [name for name in cameras if not any(name in pair for pair in shared)]
    return "; ".join([*pairs, *(f"{name} shares none" for name in alone)])


def graph_options(cameras: Sequence[str], shared: Mapping[tuple[str, str], int]) -> dict[str, object]:
    """Cameras on a circle; lines with counts: green from `ENOUGH_TOGETHER` moments on, yellow below. A camera without is red."""

    def camera(name: str) -> dict[str, object]:
        own = [count for pair, count in shared.items() if name in pair]
        return {"name": name, "itemStyle": {"color": (_GOOD if max(own) >= ENOUGH_TOGETHER else _DOUBT) if own else _BAD}}

    def line(pair: tuple[str, str], count: int) -> dict[str, object]:
        enough = count >= ENOUGH_TOGETHER
        style = {"color": _GOOD if enough else _DOUBT, "type": "solid" if enough else "dashed", "opacity": 1.0}
        width = 2 + 4 * min(count / ENOUGH_TOGETHER, 1.0)
        return {"source": pair[0], "target": pair[1], "value": count, "lineStyle": {**style, "width": width}}

    label = {"show": True, "color": "#78909c", "fontSize": 14, "fontWeight": 600}
    drawn = {
        "type": "graph", "layout": "circular", "top": 40, "bottom": 40, "symbolSize": 30, "label": {**label, "position": "top"},
        "edgeLabel": {**label, "formatter": "{c}"},
        "data": [camera(name) for name in cameras], "links": [line(*one) for one in shared.items()],
    }  # fmt: skip
    return {"series": [drawn], "animation": False}


def _graph(cameras: Sequence[str], together: Sequence[Sequence[int]]) -> None:
    shared = shared_views(cameras, together)
    drawing = ui.echart(graph_options(cameras, shared)).classes("pf-graph")
    drawing.props["role"], drawing.props["aria-label"] = "img", graph_words(cameras, shared)


def print_dialog(studio: Studio, project: Project, use: Callable[[Project], None]) -> None:
    """Make or choose the targets; `use` takes the project with those chosen."""
    lenses: Step = "intrinsics" if project.lenses else "verify"

    async def make() -> None:
        with refusals():
            names = await asyncio.to_thread(print_targets, studio.workspace, cube() | board(), str(page.value), lenses)
            for choice, step, name in zip((cubes, boards), ("extrinsics", lenses), names, strict=True):
                choice.set_options(targets(studio.workspace, step), value=name)
            with made:
                for name in names:
                    pdf = name.replace(".toml", ".pdf")
                    ui.link(f"Open {pdf}", file_address(pdf), new_tab=True)
                small(f"Print at 100 %, then measure the ruler on the sheet. Marker {FLOOR_ID} is for the floor.")

    def choose() -> None:
        if not (cubes.value and boards.value):
            raise InputError("Choose a cube and a board; Make PDF files makes both")
        use(replace(project, cube=str(cubes.value), board=str(boards.value)))

    with dialog("Targets", {"Use these": choose}):
        page = ui.select(list(PAGES_M), value="a4", label="Paper").classes("w-32")
        cube = setting_fields(TargetDescription, {"marker_mm": "Cube: black square, mm"}, {"marker_mm": 120})
        with ui.row().classes("items-end gap-3"):
            labels = {"columns": "Board: squares across", "rows": "down", "square_mm": "square, mm"}
            board = setting_fields(TargetDescription, labels, {"columns": 5, "rows": 7, "square_mm": 36})
        made = ui.column().classes("gap-1")
        ui.button("Make PDF files", icon="picture_as_pdf", on_click=make).props("outline")
        cubes, boards = (
            ui.select(names, value=now if now in names else None, label=label).classes("w-72")
            for label, names, now in (
                ("Cube in use", targets(studio.workspace, "extrinsics"), project.cube),
                ("Board in use", targets(studio.workspace, lenses), project.board),
            )
        )


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
