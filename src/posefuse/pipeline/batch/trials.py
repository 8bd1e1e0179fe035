"""Which sessions a study has: every folder below it with data of cameras."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from posefuse.core import InputError
from posefuse.pipeline.session import KINDS, data_entries, rig_files


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
