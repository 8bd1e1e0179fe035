"""What a process does for one trial: track, save, report; and what it answers."""

from __future__ import annotations

import hashlib
import json
import time
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from posefuse import __version__
from posefuse.core import InputError, PosefuseError, Progress, Recording, silent
from posefuse.evaluation.biomechanics import BiomechanicsSettings, write_biomechanics
from posefuse.foundation.output_folder import output_folder
from posefuse.foundation.parsing import plain
from posefuse.pipeline.config import CONFIG_FILE, TrackConfig, changed_config, read_config
from posefuse.pipeline.reading import files_of_result
from posefuse.pipeline.result_folder import ResultFolder, unfinished_work
from posefuse.pipeline.session import KINDS, Session, data_entries, find_session, rig_files
from posefuse.pipeline.track import track_session

from .page import recording_figures

# Which sessions a study has: every folder below it with data of cameras.


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One session of a study.

    Attributes:
        name: path of the session below the study, with forward slashes, e.g. ``P01/walk1``.
        session: the folder. rig: calibration file; None: the one in the session.
    """

    name: str
    session: Path
    rig: Path | None = None

    @property
    def participant(self) -> str:
        """The first folder of the name."""
        return self.name.partition("/")[0]

    @property
    def label(self) -> str:
        """The rest of the name; the name itself where there is one folder only."""
        return self.name.partition("/")[2] or self.name


def find_trials(study: Path) -> list[Trial]:
    """All sessions below a folder, by name.

    A session has videos, images or 2D poses where `posefuse track` looks for them. One without a calibration file uses the
    nearest one above it, up to the study. Folders inside a session, and hidden ones, are not searched.

    Raises:
        InputError: no such folder, or no session below it.
    """
    if not study.is_dir():
        raise InputError(f"{study}: no such folder")
    top = study.resolve()
    if _has_data(top):
        raise InputError(f"{study}: is a session itself; use posefuse track, or name the folder that its sessions are in")
    trials = [
        Trial(name=session.relative_to(top).as_posix(), session=session, rig=_rig_above(session, top))
        for session in _sessions(top)
    ]
    if not trials:
        raise InputError(f"{study}: no session found below it; expected folders such as P01/walk1 with a calibration and videos")
    return trials


def _sessions(folder: Path) -> Iterator[Path]:
    for entry in sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith(".")):
        if _has_data(entry):
            yield entry
        else:
            yield from _sessions(entry)


def _has_data(folder: Path) -> bool:
    return any(data_entries(folder, kind) for kind in KINDS)


def _rig_above(session: Path, top: Path) -> Path | None:
    """The nearest calibration file above a session that has none of its own."""
    if rig_files(session):
        return None
    above = [folder for folder in session.parents if folder == top or folder.is_relative_to(top)]
    return next((found[0] for folder in above if (found := rig_files(folder))), None)


REPORT_FOLDER = "biomechanics"


@dataclass(frozen=True, kw_only=True)
class Task:
    """One trial to be done.

    Attributes:
        name, session, rig: of the trial. out: result folder. formats: outputs. settings: changes by dotted key.
        report: write the report, too. made_with: what the result depends on, see `trial_digest`.
    """

    name: str
    session: str
    rig: str | None
    out: str
    formats: tuple[str, ...]
    settings: Mapping[str, Any]
    report: bool
    made_with: str


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a trial.

    Attributes:
        name: of the trial. made_with: as in its task. reason: why it failed; empty where it is complete.
        seconds: it took. warnings: lines about what is not as it should be. figures: by name, numbers or lists of them.
    """

    name: str
    made_with: str
    reason: str = ""
    seconds: float = 0.0
    warnings: tuple[str, ...] = ()
    figures: Mapping[str, Any] = field(default_factory=dict)

    @staticmethod
    def from_json(text: str) -> Outcome:
        """The value of `to_json`; raises ValueError, KeyError or TypeError for any other text."""
        values = json.loads(text)
        return Outcome(**{**values, "warnings": tuple(values["warnings"])})

    def to_json(self) -> str:
        """One line."""
        return json.dumps(plain(vars(self)))


def run_task(task: Task, progress: Progress = silent) -> Outcome:
    """Track a session, save the result and its report; an older result of posefuse in its place is replaced.

    Returns:
        The outcome; a known error is its reason.
    """
    began = time.monotonic()
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UserWarning)
            figures = plain(_figures(task, progress))
    except PosefuseError as error:
        return Outcome(name=task.name, made_with=task.made_with, reason=str(error), seconds=time.monotonic() - began)
    return Outcome(
        name=task.name,
        made_with=task.made_with,
        seconds=time.monotonic() - began,
        warnings=tuple(dict.fromkeys(str(one.message) for one in caught)),
        figures=figures,
    )


def _figures(task: Task, progress: Progress) -> dict[str, Any]:
    config = config_of_trial(Path(task.session), task.rig, {"outputs": task.formats, **task.settings})
    session, out = find_session(Path(task.session), config), Path(task.out)
    recording = _tracked(session, config, out, progress)
    if task.report:
        _write_report(recording, out, task.name, progress)
    return recording_figures(recording)


def _tracked(session: Session, config: TrackConfig, out: Path, progress: Progress) -> Recording:
    """Track into the result folder, from the detections of an interrupted run where it was made in the same way."""
    if unfinished_work(out) is not None:
        try:
            folder = ResultFolder(path=out, resume=True)
            return track_session(session, config, folder, progress, solve_interrupted=False).recording
        except InputError as error:
            progress("detect", 0, None, f"starting from the beginning: {error}")
    folder = ResultFolder(path=out, force=True)
    return track_session(session, config, folder, progress, solve_interrupted=False).recording


def _write_report(recording: Recording, out: Path, title: str, progress: Progress) -> None:
    """A person without joint angles is no reason to lose the points."""
    with output_folder(out / REPORT_FOLDER, command="report", inputs=files_of_result(out), replace=True) as folder:
        try:
            write_biomechanics(recording, folder.folder, BiomechanicsSettings(), title=title, progress=progress)
        except InputError as error:
            warnings.warn(f"no report: {error}", UserWarning, stacklevel=2)


def config_of_trial(session: Path, rig: str | None, settings: Mapping[str, Any]) -> TrackConfig:
    """The settings file of a session with the study's changes on top; raises ConfigError for a wrong one."""
    path = session / CONFIG_FILE
    named = {} if rig is None else {"rig": rig}
    return changed_config(read_config(path if path.is_file() else None), {**named, **settings})


def trial_digest(trial: Trial, formats: tuple[str, ...], settings: Mapping[str, Any], report: bool) -> str:
    """A digest of what a result depends on: version, settings, and name, size and date of every file of the session."""
    files = sorted(path for path in trial.session.rglob("*") if path.is_file())
    listed = [[path.relative_to(trial.session).as_posix(), path.stat().st_size, path.stat().st_mtime_ns] for path in files]
    rig = [] if trial.rig is None else [str(trial.rig), trial.rig.stat().st_mtime_ns]
    about = json.dumps(plain([__version__, listed, rig, sorted(formats), dict(sorted(settings.items())), report]))
    return hashlib.sha256(about.encode()).hexdigest()[:16]
