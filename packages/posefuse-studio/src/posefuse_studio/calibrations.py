"""A calibration of the workspace: what is known of each camera, and the next step. Decided here, shown by the page.

A folder ``calibrations/NAME`` has ``project.json``, a folder of videos per recording, and the results of `work.calibrate`.
"""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from .jobs import read_json_or_empty, write_json
from .workspace import StudioWorkspace, check_name

FOLDER = "calibrations"
LENSES, RIG = "lenses.toml", "rig.toml"
LIGHTS = ("intrinsics", "overlap", "extrinsics", "clocks", "scale", "verified")
Action = Literal["print", "record", "solve", "use"]
Step = Literal["intrinsics", "extrinsics", "verify"]
_STEPS: tuple[Step, ...] = ("intrinsics", "extrinsics", "verify")
_COVERAGE = "coverage.json"


@dataclass(frozen=True, kw_only=True)
class Project:
    """Attributes:
    name: of the folder. setup: preset of the cameras. cube, board: target files; empty while there is none.
    lenses: whether the lenses are calibrated on their own first, with the board; otherwise from the cube's recording.
    """

    name: str
    setup: str
    cube: str = ""
    board: str = ""
    lenses: bool = True

    @property
    def folder(self) -> str:
        """Its name in the workspace."""
        return f"{FOLDER}/{self.name}"

    @property
    def steps(self) -> tuple[Step, ...]:
        """In their order; each rests on those before it."""
        return _STEPS if self.lenses else _STEPS[1:]

    def target(self, step: Step) -> str:
        """The target file of a step."""
        return self.cube if step == "extrinsics" else self.board


@dataclass(frozen=True, kw_only=True)
class Known:
    """What a project has so far.

    Attributes:
        cameras: names. recordings: newest folder of each step that has one. coverage: of these, see `work.watch`.
        results: of `work.calibrate` by step. outdated: steps whose result rests on lenses or positions that are others now.
    """

    cameras: tuple[str, ...]
    recordings: Mapping[Step, str] = field(default_factory=dict)
    coverage: Mapping[Step, Mapping[str, Any]] = field(default_factory=dict)
    results: Mapping[Step, Mapping[str, Any]] = field(default_factory=dict)
    outdated: frozenset[Step] = frozenset()

    def passed(self, step: Step) -> bool:
        """Whether a step is done, from its newest recording and what it rests on now."""
        return self._current(step) and bool(self.results[step]["passed"])

    def refused(self, step: Step) -> bool:
        """Whether its newest recording was refused."""
        return self._current(step) and not self.results[step]["passed"]

    def can_solve(self, step: Step, project: Project) -> bool:
        """Whether its newest recording shows the target that is in use now."""
        return step in self.recordings and self.coverage.get(step, {}).get("target") == project.target(step)

    def _current(self, step: Step) -> bool:
        if step not in self.results or step in self.outdated:
            return False
        return bool(self.results[step].get("recording") == self.recordings.get(step))


@dataclass(frozen=True, kw_only=True)
class Next:
    """What to do: in large letters, why, and what the button does; `back`: other steps that may have to be done again."""

    words: str
    why: str
    action: Action
    step: Step = "extrinsics"
    back: tuple[Step, ...] = ()


@dataclass(frozen=True)
class Light:
    """``good``, ``bad``, ``doubt`` or ``off``, and a word on it."""

    state: str
    text: str


def next_step(project: Project, known: Known) -> Next:
    """The one thing to do next."""
    if not project.cube or not project.board:
        return Next(
            words="Print a cube and a board",
            why="Glue six markers on a stiff box and the board on a flat plate; marker 43 is for the floor. Measure the ruler.",
            action="print",
        )
    for number, step in enumerate(project.steps):
        if known.passed(step):
            continue
        if known.refused(step):
            check = failed_checks(known.results[step])[0]
            again = _mended_by(check, step, project)
            others = tuple(one for one in project.steps[: number + 1] if one != again)
            words = check["remedy"] or check["detail"]
            return Next(words=words, why=f"Refused: {check['detail']}", action="record", step=again, back=others)
        if known.can_solve(step, project):
            early = "; it was stopped before enough was seen" if known.coverage[step].get("enough") is False else ""
            return Next(words=_SOLVE[step], why=f"from {known.recordings[step]}{early}", action="solve", step=step)
        return Next(words=_RECORD[step][0], why=_RECORD[step][1], action="record", step=step)
    return Next(words="The rig is verified", why="Use it for live sessions of these cameras.", action="use", step="verify")


def _mended_by(check: Mapping[str, Any], step: Step, project: Project) -> Step:
    """The step to record again where a check of a step fails: that step, or an earlier one that is to blame."""
    if check.get("kind") == "lenses" and project.lenses:
        return "intrinsics"
    return "extrinsics" if check.get("kind") == "rig" else step


_RECORD: Mapping[Step, tuple[str, str]] = {
    "intrinsics": ("Show the board to each camera", "Near and far, tilted, into every corner of each image."),
    "extrinsics": (
        "Move the cube where two cameras see it",
        "Slowly through the whole volume, turning it; marker 43 lies on the floor, face up, where two cameras see it.",
    ),
    "verify": ("Show the board to two cameras at once", "A target that the rig was not made from shows its true error."),
}
RESTS: Mapping[Step, str] = {
    "intrinsics": "Positions and verification rest on it: after new lenses, they are calculated again.",
    "extrinsics": "The verification rests on it: after new positions, it is recorded again.",
    "verify": "Nothing rests on it: repeat it whenever a camera may have been touched.",
}


def step_light(step: Step, project: Project, known: Known) -> Light:
    """How far a step is."""
    if known.passed(step):
        return Light("good", "passed")
    if known.refused(step):
        return Light("bad", "refused")
    if step in known.outdated:
        return Light("doubt", "rests on earlier lenses or positions")
    return Light("doubt", "recorded") if known.can_solve(step, project) else Light("off", "not yet")


_SOLVE: Mapping[Step, str] = {
    "intrinsics": "Calibrate the lenses",
    "extrinsics": "Find where the cameras stand",
    "verify": "Verify the rig",
}


def failed_checks(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The checks that do not hold, of all reports of a result."""
    return [{**check, "subject": one["subject"]} for one in result["reports"] for check in one["checks"] if not check["passed"]]


def blamed_cameras(check: Mapping[str, Any], cameras: Sequence[str]) -> tuple[str, ...]:
    """The cameras that a check names, as whole words, in its subject or its detail."""
    text = f"{check.get('subject', '')} {check['detail']}"
    return tuple(name for name in cameras if re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", text))


def lights(project: Project, known: Known) -> dict[str, dict[str, Light]]:
    """By camera and kind of light."""
    return {camera: _lights_of(camera, project, known) for camera in known.cameras}


def _lights_of(camera: str, project: Project, known: Known) -> dict[str, Light]:
    off = Light("off", "not yet")
    solved = camera in known.results.get("extrinsics", {}).get("cameras", ()) and known.passed("extrinsics")
    refused = known.refused("extrinsics")
    blamed = refused and any(blamed_cameras(check, [camera]) for check in failed_checks(known.results["extrinsics"]))
    placed = Light("good", "placed") if solved else Light("bad" if blamed else "doubt", "refused") if refused else off
    verified = known.results.get("verify")
    return {
        "intrinsics": _intrinsics_light(camera, project, known, solved),
        "overlap": _overlap_light(camera, known),
        "extrinsics": placed,
        "clocks": Light("good", str(known.results["extrinsics"].get("clocks", "known"))) if solved else off,
        "scale": Light("good", "from the cube") if solved else off,
        "verified": off
        if not verified or not solved
        else Light("good", "passed")
        if known.passed("verify")
        else Light("bad", "failed"),
    }


def _intrinsics_light(camera: str, project: Project, known: Known, solved: bool) -> Light:
    if known.passed("intrinsics"):
        return Light("good", "from the board")
    if known.refused("intrinsics"):
        blamed = any(blamed_cameras(check, [camera]) for check in failed_checks(known.results["intrinsics"]))
        return Light("bad", "refused") if blamed else Light("doubt", "waits for the others")
    return Light("good", "from the cube") if solved and not project.lenses else Light("off", "not yet")


def _overlap_light(camera: str, known: Known) -> Light:
    seen = known.coverage.get("extrinsics")
    if not seen or camera not in seen.get("cameras", ()):
        return Light("off", "not yet")
    i = list(seen["cameras"]).index(camera)
    linked = max((share for j, share in enumerate(seen["linked"][i]) if j != i), default=0.0)
    covered = float(seen["covered"][i])
    if linked >= 1.0 and covered >= 1.0:
        return Light("good", "enough")
    return Light(
        "doubt" if linked > 0 else "bad", f"{min(linked, covered):.0%} of what is needed" if linked else "seen with no other"
    )


def projects(workspace: StudioWorkspace) -> list[Project]:
    """All of the workspace by name."""
    folder = workspace.path(FOLDER)
    found = []
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        content = read_json_or_empty(path / "project.json")
        if isinstance(content.get("setup"), str):
            texts = {key: str(content.get(key, "")) for key in ("setup", "cube", "board")}
            found.append(Project(name=path.name, lenses=bool(content.get("lenses", True)), **texts))
    return found


def save_project(workspace: StudioWorkspace, project: Project) -> None:
    """Write it; raises InputError for a name that is not plain."""
    check_name(project.name)
    content = {"setup": project.setup, "cube": project.cube, "board": project.board, "lenses": project.lenses}
    write_json(workspace.folder(project.folder) / "project.json", content)


def known_of(workspace: StudioWorkspace, project: Project, cameras: Sequence[str]) -> Known:
    """The content of the files of a project."""
    folder = workspace.path(project.folder)
    recordings: dict[Step, str] = {}
    coverage: dict[Step, Mapping[str, Any]] = {}
    results: dict[Step, Mapping[str, Any]] = {}
    placed_ns = 0
    for step in _STEPS:
        found = [path for path in folder.glob(f"{step}-*") if (path / _COVERAGE).is_file()]
        if _whole(result := read_json_or_empty(folder / f"{step}.json")):
            results[step] = result
        newest = max((path for path in found if not _too_short(path, results.get(step))), key=_recorded_ns, default=None)
        # when a verification was recorded before the positions, the cameras may have stood elsewhere
        if newest is not None and not (step == "verify" and _recorded_ns(newest) < placed_ns):
            recordings[step], seen = f"{project.folder}/{newest.name}", read_json_or_empty(newest / _COVERAGE)
            coverage[step] = seen if {"cameras", "covered", "linked"} <= seen.keys() else {}
        if newest is not None and step == "extrinsics":
            placed_ns = _recorded_ns(newest)
    outdated = frozenset(step for step, result in results.items() if result.get("rests_on", "") != rests_on(folder, step))
    return Known(cameras=tuple(cameras), recordings=recordings, coverage=coverage, results=results, outdated=outdated)


def rests_on(folder: Path, step: Step) -> str:
    """What a result is made from, besides its recording: a hash of the lenses or of the rig; empty where there is none."""
    name = {"extrinsics": LENSES, "verify": RIG}.get(step)
    path = folder / name if name else None
    return hashlib.sha256(path.read_bytes()).hexdigest() if path is not None and path.is_file() else ""


def new_recording(workspace: StudioWorkspace, project: Project, step: Step) -> str:
    """The name of a folder that is not there yet."""
    names = (f"{project.folder}/{step}-{number}" for number in itertools.count(1))
    return next(name for name in names if not workspace.path(name).exists())


def last_worked_on(workspace: StudioWorkspace, found: Sequence[Project]) -> str:
    """The name of the project whose files changed last; empty where there is none."""
    return max(found, key=lambda one: workspace.path(one.folder).stat().st_mtime_ns).name if found else ""


def _too_short(recording: Path, result: Mapping[str, Any] | None) -> bool:
    """Whether it was stopped too early to take the place of one that has passed; the button may have been pressed by mistake."""
    if result is None or not result["passed"] or str(result.get("recording")).endswith(f"/{recording.name}"):
        return False
    return read_json_or_empty(recording / _COVERAGE).get("enough") is False


def _recorded_ns(recording: Path) -> int:
    return (recording / _COVERAGE).stat().st_mtime_ns


def _whole(result: Mapping[str, Any]) -> bool:
    """Whether it is as `work.calibrate` writes it; a damaged one is as none."""
    reports = result.get("reports")
    return isinstance(result.get("passed"), bool) and isinstance(reports, list) and all(map(_whole_report, reports))


def _whole_report(report: Any) -> bool:
    if not isinstance(report, dict) or not {"subject", "checks", "numbers"} <= report.keys():
        return False
    return all(isinstance(one, dict) and {"name", "passed", "detail", "remedy"} <= one.keys() for one in report["checks"])
