"""What a process does for one trial: track, save, report; and what it answers."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

from posefuse import __version__
from posefuse.core import InputError, PosefuseError, Recording
from posefuse.core.errors import warn_caller
from posefuse.foundation.parsing import plain
from posefuse.pipeline.config import CONFIG_FILE, TrackConfig, read_config
from posefuse.pipeline.reading import is_result
from posefuse.pipeline.result_folder import ResultFolder, unfinished_work
from posefuse.pipeline.session import KINDS, RIG_FOLDERS, data_entries, find_session, looks_like_session, rig_files
from posefuse.pipeline.track import track_session
from posefuse.pipeline.writing import report_folder, write_report_folder

from .figures import recording_figures

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
    nearest one above it, up to the study. A folder that only has a calibration, or a folder for videos, is one that fails.
    Folders inside a session or a result, those of calibrations, and hidden ones are not searched.

    Raises:
        InputError: no such folder, or no session below it.
    """
    if not study.is_dir():
        raise InputError(f"{study}: no such folder")
    top = study.resolve()
    if _has_data(top) and not is_result(top):
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
        # a result has a video, too: the overlay
        if is_result(entry) or entry.name in RIG_FOLDERS:
            continue
        below = [entry] if _has_data(entry) else list(_sessions(entry))
        yield from below or ([entry] if looks_like_session(entry) else [])


def _has_data(folder: Path) -> bool:
    return any(data_entries(folder, kind) for kind in KINDS)


def _rig_above(session: Path, top: Path) -> Path | None:
    """The nearest calibration file above a session that has none of its own."""
    if rig_files(session):
        return None
    above = [folder for folder in session.parents if folder == top or folder.is_relative_to(top)]
    return next((found[0] for folder in above if (found := rig_files(folder))), None)


@dataclass(frozen=True, kw_only=True)
class Task:
    """One trial to be done.

    Attributes:
        trial: of the study. out: result folder. settings: changes by dotted key, ``outputs`` among them.
        report: write the report, too.
    """

    trial: Trial
    out: Path
    settings: Mapping[str, Any]
    report: bool

    @property
    def config(self) -> TrackConfig:
        """The settings file of the session with the study's changes on top; raises ConfigError for a wrong one."""
        path = self.trial.session / CONFIG_FILE
        rig = {} if self.trial.rig is None else {"rig": str(self.trial.rig)}
        return read_config(path if path.is_file() else None, {**rig, **self.settings})

    @cached_property
    def made_with(self) -> str:
        """A digest of what the result depends on: version, settings, and name, size and date of every file of the session."""
        session, rig = self.trial.session, self.trial.rig
        files = [*sorted(path for path in session.rglob("*") if path.is_file()), *([] if rig is None else [rig])]
        listed = [[os.path.relpath(path, session), path.stat().st_size, path.stat().st_mtime_ns] for path in files]
        about = json.dumps(plain([__version__, listed, dict(sorted(self.settings.items())), self.report]))
        return hashlib.sha256(about.encode()).hexdigest()[:16]

    def outcome(self, *, reason: str = "", warnings: Sequence[str] = (), **found: Any) -> Outcome:
        """What became of it; its lines name files as they lie in the study or its results, wherever these are moved to."""
        lines = tuple(dict.fromkeys(map(self._line, warnings)))
        return Outcome(name=self.trial.name, made_with=self.made_with, reason=self._line(reason), warnings=lines, **found)

    def _line(self, text: str) -> str:
        """What is an argument of `track` in a message, `` `rig=FILE` ``, a study takes as one of its settings."""
        for folder in (self.trial.session, self.out):
            text = text.replace(f"{folder.parents[self.trial.name.count('/')]}{os.sep}", "")
        names = "|".join(one.name for one in fields(TrackConfig))
        return re.sub(rf"`(?=(?:{names})[.=])", "`settings=", text.replace("`people=", "`associate.max_people="))


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a trial.

    Attributes:
        name: of the trial. made_with: as in its task. reason: why it failed; empty where it is complete.
        seconds: it took. warnings: lines about what is not as it should be. figures: numbers by name.
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


def completed(task: Task) -> Outcome | None:
    """The outcome that any run of the study stored of a trial whose result is there; None: it is to be done."""
    outcome = stored_outcome(task.out.with_name(f"{task.out.name}.json"))
    return outcome if outcome is not None and not outcome.reason and task.out.is_dir() else None


def stored_outcome(path: Path) -> Outcome | None:
    """The outcome in a file; None where there is none, or something else."""
    try:
        return Outcome.from_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, TypeError, KeyError):
        return None


def run_task(task: Task) -> Outcome:
    """Track a session, save the result and its report; an older result of posefuse in its place is replaced.

    Returns:
        The outcome; a known error is its reason. Where another run made the same meanwhile it is that run's.
    """
    meanwhile = completed(task)
    if meanwhile is not None and meanwhile.made_with == task.made_with:
        return meanwhile
    began = time.monotonic()
    found: dict[str, Any]
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", UserWarning)
            recording = _tracked(task)
            if task.report:
                _write_report(recording, task)
            found = {"figures": plain(recording_figures(recording))}
        found["warnings"] = [str(one.message) for one in caught]
    except PosefuseError as error:
        found = {"reason": str(error)}
    return task.outcome(seconds=time.monotonic() - began, **found)


def _tracked(task: Task) -> Recording:
    """Track into the result folder, from the detections of an interrupted run where it was made in the same way."""
    config, out = task.config, task.out
    session = find_session(task.trial.session, config)
    if unfinished_work(out) is not None:
        # made in another way: from the beginning
        with contextlib.suppress(InputError):
            return track_session(session, config, ResultFolder(path=out, resume=True)).recording
    return track_session(session, config, ResultFolder(path=out, force=True)).recording


def _write_report(recording: Recording, task: Task) -> None:
    """A person without joint angles is no reason to lose the points."""
    try:
        write_report_folder(recording, task.out, report_folder(task.out), title=task.trial.name)
    except InputError as error:
        warn_caller(f"no report: {error}")
