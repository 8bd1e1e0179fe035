"""A calibration of the workspace: what is known of each camera, and the next step. Decided here, shown by the page.

A folder ``calibrations/NAME`` has ``project.json``, a folder of videos per recording, and the results of `work.calibrate`.
"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict

import posefuse as pf
from posefuse.api.calibrate import target_of
from posefuse.calibration.report import CalibrationReport, Check
from posefuse.calibration.targets.coverage import ENOUGH_TOGETHER, TargetCoverage
from posefuse.calibration.targets.kinds import Charuco, Markers, Target, check_board
from posefuse.core import InputError, PosefuseError
from posefuse.core.arrays import Array
from posefuse_studio.workspace import StudioWorkspace, check_name, read_stored, write_stored

FOLDER = "calibrations"
LENSES, RIG, SEEN = "lenses.toml", "rig.toml", "coverage.json"
Action = Literal["print", "record", "solve", "use"]
Step = Literal["intrinsics", "extrinsics", "verify"]
STEPS: tuple[Step, ...] = ("intrinsics", "extrinsics", "verify")
"""In their order; each rests on those before it."""


@dataclass(frozen=True, kw_only=True)
class Project:
    """Attributes:
    name: of the folder. setup: preset of the cameras. cube, board: target files; empty while there is none.
    """

    name: str = ""
    setup: str
    cube: str = ""
    board: str = ""

    @property
    def folder(self) -> str:
        """Its name in the workspace."""
        return f"{FOLDER}/{self.name}"

    def target(self, step: Step) -> str:
        """The target file of a step."""
        return self.cube if step == "extrinsics" else self.board


@dataclass(frozen=True, kw_only=True)
class SeenTarget:
    """That a recording shows a target. `enough`: for its step."""

    target: str = ""
    enough: bool = True


@dataclass(frozen=True, kw_only=True)
class StepResult:
    """What a step has given, as `work.calibrate` writes it.

    Attributes:
        reports: one, for lenses one per camera. recording: it was made from. rests_on: see there.
        position_cov_m2: see `RigCalibration`. world: where it comes from; empty: not known.
    """

    __pydantic_config__ = ConfigDict(ser_json_inf_nan="constants")

    passed: bool
    reports: list[CalibrationReport]
    recording: str = ""
    rests_on: str = ""
    position_cov_m2: dict[str, list[list[float]]] = field(default_factory=dict)
    world: str = ""

    @property
    def failed(self) -> list[tuple[str, Check]]:
        """The checks that do not hold, of all reports, each with what was calibrated."""
        return [(report.subject, check) for report in self.reports for check in report.failed]


@dataclass(frozen=True, kw_only=True)
class StepState:
    """How far a step is.

    Attributes:
        recording: its newest folder; empty: none. seen: in it. result: the newest.
        outdated: whether the result rests on lenses or positions that are others now.
    """

    recording: str = ""
    seen: SeenTarget | None = None
    result: StepResult | None = None
    outdated: bool = False

    @property
    def current(self) -> StepResult | None:
        """The result, if it is from the newest recording and what it rests on now."""
        return None if self.outdated or self.result is None or self.result.recording != self.recording else self.result

    @property
    def passed(self) -> bool:
        """Whether the step is done."""
        return self.current is not None and self.current.passed


NOTHING = StepState()


@dataclass(frozen=True, kw_only=True)
class Next:
    """What to do: in large letters, why, and what the button does."""

    words: str
    why: str
    action: Action
    step: Step = "extrinsics"


_RECORD: Mapping[Step, tuple[str, str]] = {
    "intrinsics": ("Show the board to each camera", "Near and far, tilted, into every corner of each image."),
    "extrinsics": (
        "Move the cube where two cameras see it",
        "Slowly through the whole volume, turning it; marker 43 lies on the floor, face up, where two cameras see it.",
    ),
    "verify": ("Show the board to two cameras at once", "A target that the rig was not made from shows its true error."),
}
_SOLVE: Mapping[Step, str] = {
    "intrinsics": "Calibrate the lenses",
    "extrinsics": "Find where the cameras stand",
    "verify": "Verify the rig",
}


@dataclass(frozen=True, kw_only=True)
class Known:
    """What there is of a project so far; `steps`: those of which there is anything."""

    project: Project
    steps: Mapping[Step, StepState] = field(default_factory=dict)

    def __getitem__(self, step: Step) -> StepState:
        """How far a step is."""
        return self.steps.get(step, NOTHING)

    def can_solve(self, step: Step) -> bool:
        """Whether its newest recording shows the target that is in use now."""
        seen = self[step].seen
        return seen is not None and seen.target == self.project.target(step)

    def next_step(self) -> Next:
        """The one thing to do next."""
        project = self.project
        if not project.cube or not project.board:
            why = "Glue six markers on a stiff box and the board on a flat plate; marker 43 is for the floor. Measure the ruler."
            return Next(words="Print a cube and a board", why=why, action="print")
        for step in STEPS:
            state = self[step]
            if state.passed:
                continue
            if state.current is not None:
                _, check = state.current.failed[0]
                again = _mended_by(check, step)
                why = f"Refused: {check.detail}"
                return Next(words=check.remedy or check.detail, why=why, action="record", step=again)
            if self.can_solve(step) and state.seen is not None:
                early = "" if state.seen.enough else "; it was stopped before enough was seen"
                return Next(words=_SOLVE[step], why=f"from {state.recording}{early}", action="solve", step=step)
            return Next(words=_RECORD[step][0], why=_RECORD[step][1], action="record", step=step)
        return Next(words="The rig is verified", why="Use it for live sessions of these cameras.", action="use", step="verify")

    def step_light(self, step: Step) -> tuple[str, str]:
        """How far a step is: ``good``, ``bad``, ``doubt`` or ``off``, and a word on it."""
        state = self[step]
        if state.current is not None:
            return ("good", "passed") if state.passed else ("bad", "refused")
        if state.outdated:
            return "doubt", "rests on earlier lenses or positions"
        return ("doubt", "recorded") if self.can_solve(step) else ("off", "not yet")


def _mended_by(check: Check, step: Step) -> Step:
    """The step to record again where a check of a step fails: that step, or an earlier one that is to blame."""
    if check.kind == "lenses":
        return "intrinsics"
    return "extrinsics" if check.kind == "rig" else step


def projects(workspace: StudioWorkspace) -> dict[str, Project]:
    """All of the workspace by name, the one that was worked on last first."""
    folder = workspace.path(FOLDER)
    places = sorted(folder.iterdir(), key=lambda path: -path.stat().st_mtime_ns) if folder.is_dir() else []
    found = {path.name: read_stored(path / "project.json", Project) for path in places}
    return {name: replace(project, name=name) for name, project in found.items() if project is not None}


def save_project(workspace: StudioWorkspace, project: Project) -> None:
    """Write it; raises InputError for a name that is not plain."""
    check_name(project.name)
    write_stored(workspace.folder(project.folder) / "project.json", project)


def known_of(workspace: StudioWorkspace, project: Project) -> Known:
    """The content of the files of a project."""
    folder = workspace.path(project.folder)
    steps: dict[Step, StepState] = {}
    placed_ns = 0
    for step in STEPS:
        result = read_stored(folder / f"{step}.json", StepResult)
        taken = max(_recordings(folder, step, result), key=_recorded_ns, default=None)
        outdated = result is not None and result.rests_on != rests_on(folder, step)
        steps[step] = StepState(result=result, outdated=outdated)
        # when a verification was recorded before the positions, the cameras may have stood elsewhere
        if taken is not None and not (step == "verify" and _recorded_ns(taken) < placed_ns):
            seen = read_stored(taken / SEEN, SeenTarget)
            steps[step] = replace(steps[step], recording=f"{project.folder}/{taken.name}", seen=seen)
        if taken is not None and step == "extrinsics":
            placed_ns = _recorded_ns(taken)
    return Known(project=project, steps=steps)


def _recordings(folder: Path, step: Step, result: StepResult | None) -> Iterator[Path]:
    """Those that count: one that was stopped too early takes no result away; the button may have been pressed by mistake."""
    for path in folder.glob(f"{step}-*"):
        kept = result is not None and result.passed and not result.recording.endswith(f"/{path.name}")
        if (path / SEEN).is_file() and not (
            kept and (seen := read_stored(path / SEEN, SeenTarget)) is not None and not seen.enough
        ):
            yield path


def rests_on(folder: Path, step: Step) -> str:
    """What a result is made from, besides its recording: a hash of the lenses or of the rig; empty where there is none."""
    name = {"extrinsics": LENSES, "verify": RIG}.get(step)
    path = folder / name if name else None
    return hashlib.sha256(path.read_bytes()).hexdigest() if path is not None and path.is_file() else ""


def new_recording(workspace: StudioWorkspace, project: Project, step: Step) -> str:
    """The name of a folder that is not there yet."""
    names = (f"{project.folder}/{step}-{number}" for number in itertools.count(1))
    return next(name for name in names if not workspace.path(name).exists())


def _recorded_ns(recording: Path) -> int:
    return (recording / SEEN).stat().st_mtime_ns


def stamp(workspace: StudioWorkspace, project: Project) -> list[tuple[str, int]]:
    """What changes when `known_of` has something new to read."""
    files = workspace.path(project.folder).rglob("*.json")
    return sorted((str(path), path.stat().st_mtime_ns) for path in files)


TARGETS = "targets"
FLOOR_ID = 43
# of each image; the calibration of lenses needs 0.25 in the views that it chooses, which are fewer than those seen
LENSES_SHARE = 0.35
"""Marker that is printed with a cube and lies on the floor: the world's origin, and what is up."""
# the last of the 50 markers of the dictionary; a board takes the first ones, so that it can lie in view of a cube's recording
_CUBE_IDS = (FLOOR_ID, *range(FLOOR_ID + 1, 50))


def print_targets(workspace: StudioWorkspace, settings: Mapping[str, Any], page: str) -> tuple[str, str]:
    """Print a cube, with a marker for the floor, and a board; gives the names of their descriptions, next to which PDF files lie.

    Args:
        settings: ``marker_mm`` of the cube; ``columns``, ``rows`` and ``square_mm`` of the board.

    Raises:
        PosefuseError: targets that cannot be, that do not fit on the page, or that cannot serve.
    """
    if {"marker_mm", "columns", "rows", "square_mm"} - settings.keys():
        raise InputError("targets: expected a number in each field")
    board = {**settings, "kind": "charuco", "marker_mm": 0.75 * settings["square_mm"]}
    cube = {"kind": "markers", "marker_mm": settings["marker_mm"], "ids": _CUBE_IDS}
    sizes_m = {f"{name}_m": board[f"{name}_mm"] / 1e3 for name in ("square", "marker")}
    check_target(Charuco(columns=board["columns"], rows=board["rows"], **sizes_m), "intrinsics")
    named = {
        f"cube {cube['marker_mm']:g} mm": cube,
        f"board {board['columns']:g}x{board['rows']:g} {board['square_mm']:g} mm": board,
    }
    place = workspace.folder(TARGETS)
    made = [pf.print_target(place / f"{name}.pdf", one, page=page, replace=True) for name, one in named.items()]
    return workspace.name_of(made[0].target), workspace.name_of(made[1].target)


def without_floor(target: Target) -> Target:
    """What of a target is moved."""
    if isinstance(target, Markers) and FLOOR_ID in target.ids:
        return replace(target, ids=tuple(one for one in target.ids if one != FLOOR_ID))
    return target


def targets(workspace: StudioWorkspace, step: Step) -> list[str]:
    """Descriptions in the workspace that can serve a step of a calibration."""
    folder, found = workspace.path(TARGETS), []
    for path in sorted(folder.glob("*.toml")) if folder.is_dir() else []:
        with suppress(PosefuseError):
            check_target(target_of(path), step)
            found.append(f"{TARGETS}/{path.name}")
    return found


def check_target(target: Target, step: Step) -> None:
    """Whether it can serve the step: a cube for the positions; for the others a board, which the rig was not made from.

    Raises:
        InputError: it is of the other kind. CalibrationError: lenses cannot be calibrated from so small a board.
    """
    if isinstance(target, Markers) != (step == "extrinsics"):
        raise InputError("target: expected a cube of markers for the positions, and a board for the lenses and the verification")
    if step == "intrinsics":
        check_board(target)


def enough_for(step: Step, found: TargetCoverage) -> bool:
    """Lenses need each image covered; a verification needs each camera to share views with another; positions need both."""
    if step == "intrinsics":
        return bool((found.share >= LENSES_SHARE).all())
    if step == "verify":
        # three times the least that `verify` takes
        return bool((_shared(found) >= ENOUGH_TOGETHER).all())
    return found.enough


def advice_for(step: Step, found: TargetCoverage) -> str:
    """What to do next, in words."""
    if enough_for(step, found):
        return _named("enough: stop moving the target", step)
    if step == "intrinsics":
        # no camera needs another one: as if all were linked
        linked = np.where(np.eye(len(found.cameras), dtype=bool), found.together, ENOUGH_TOGETHER)
        return _named(replace(found, together=linked).advice(LENSES_SHARE), step)
    if step == "verify":
        shared = _shared(found)
        camera = int(np.argmin(shared))
        return f"show the board to {found.cameras[camera]} and another camera: {shared[camera]} of {ENOUGH_TOGETHER}"
    return _named(found.advice(), step)


def _named(advice: str, step: Step) -> str:
    """With the word for the target of the step."""
    return advice.replace("the target", "the cube" if step == "extrinsics" else "the board")


def _shared(found: TargetCoverage) -> Array:
    """(C,) moments that each camera shares with the one it shares most with."""
    return np.asarray(np.where(np.eye(len(found.cameras), dtype=bool), 0, found.together).max(axis=1))
