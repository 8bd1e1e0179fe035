"""The recordings below a folder with how good each is at a glance."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import posefuse as pf
from posefuse.core import PosefuseError
from posefuse.foundation.output_folder import MARK_FILE, read_mark

# how deep recordings may lie below the folder: STUDY/P01/walk1/RESULT
_DEEPEST = 5
# a live session of more is listed without figures, which would take long to read
_MOST_LIVE_BYTES = 200_000_000
_MOST_RECORDINGS = 2000
# of the picture of a recording
_WIDTH_PX = 320
# size and time of each file of a recording
_Files = tuple[tuple[int, int], ...]


@dataclass(frozen=True, kw_only=True)
class Listed:
    """A recording as a list shows it. Figures are NaN, and words empty, where they are not known.

    Attributes:
        path: result folder or .mcap. live: whether it is the recording of a live session.
        session: that it was made from. recorded: when, as the camera stated it. modified_s: of its files, seconds since 1970.
        people: names or ``person 0``. duration_s, cameras: of the recording.
        coverage: share of keypoints and time steps that are known. sigma_mm, reprojection_px: medians.
        edited: whether stretches were left out. problem: why nothing more is known.
    """

    path: Path
    live: bool
    session: str = ""
    recorded: str = ""
    modified_s: float = float("nan")
    people: tuple[str, ...] = ()
    duration_s: float = float("nan")
    cameras: int = 0
    coverage: float = float("nan")
    sigma_mm: float = float("nan")
    reprojection_px: float = float("nan")
    edited: bool = False
    problem: str = ""

    def matches(self, search: str) -> bool:
        """Whether every word of the search is in its path, session, date or people; capital letters make no difference."""
        text = " ".join((str(self.path), self.session, self.recorded, *self.people)).lower()
        return all(word in text for word in search.lower().split())


def find_recordings(folder: Path, most: int = _MOST_RECORDINGS) -> list[Path]:
    """Result folders and .mcap files below a folder, the newest first; at most so many.

    Hidden folders are left out, links are not followed.
    """
    found = [path for path, _ in zip(_found(folder, 0), range(most), strict=False)]
    return sorted(found, key=_modified_s, reverse=True)


def listed(path: Path) -> Listed:
    """A recording at a glance; one that cannot be read has a `problem`. It is read again where its files have changed."""
    return _looked_at(path, _files(path))


def thumbnail(path: Path, within: Path | None = None) -> bytes:
    """A small JPEG of a recording: its best seen view with the skeleton on top.

    Args:
        within: a folder that its videos must lie in; None: anywhere.

    Raises:
        PosefuseError: the recording cannot be read.
    """
    return _pictured(path, within, _files(path))


def _found(folder: Path, depth: int) -> Iterator[Path]:
    if _is_result(folder):
        yield folder
        return
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError:
        return
    for entry in entries:
        if entry.name.startswith("."):
            continue
        if entry.is_dir(follow_symlinks=False):
            if depth < _DEEPEST:
                yield from _found(Path(entry.path), depth + 1)
        elif _is_live(Path(entry.path)) and not _goes_with_another(Path(entry.path)):
            yield Path(entry.path)


def _goes_with_another(path: Path) -> bool:
    """Whether a .mcap file continues another one (NAME.2.mcap), or holds the robot that followed it (NAME.robot.mcap)."""
    first, _, what = path.stem.rpartition(".")
    return (what.isdigit() or what == "robot") and bool(first) and path.with_name(first + path.suffix).is_file()


def _is_live(path: Path) -> bool:
    return path.suffix.lower() == ".mcap" and not path.is_dir()


def _is_result(path: Path) -> bool:
    mark = read_mark(path)
    return mark is not None and mark.command == "track"


def _modified_s(path: Path) -> float:
    try:
        return (path if _is_live(path) else path / MARK_FILE).stat().st_mtime
    except OSError:
        return 0.0


def _files(path: Path) -> _Files:
    files = sorted(one for one in path.iterdir() if one.is_file()) if path.is_dir() else [path]
    states = [one.stat() for one in files if one.is_file()]
    return tuple((one.st_size, one.st_mtime_ns) for one in states)


@lru_cache(_MOST_RECORDINGS)
def _looked_at(path: Path, files: _Files) -> Listed:
    """`files`: size and time of each, for which it is kept."""
    live, modified_s = _is_live(path), _modified_s(path)
    try:
        if live and path.stat().st_size > _MOST_LIVE_BYTES:
            return Listed(path=path, live=True, modified_s=modified_s, problem="long: open it to see how good it is")
        recording = pf.read(path, observed=False)
    except (PosefuseError, OSError) as error:
        return Listed(path=path, live=live, modified_s=modified_s, problem=str(error))
    figures = recording.quality()
    return Listed(
        path=path,
        live=live,
        session=str(recording.provenance.get("session", "")),
        recorded=recording.recorded_utc,
        modified_s=modified_s,
        people=recording.person_names,
        duration_s=figures["duration_s"],
        cameras=figures["cameras"],
        coverage=figures["present_share"],
        sigma_mm=figures["median_sigma_mm"],
        reprojection_px=figures["median_reprojection_px"],
        edited=bool(recording.provenance.get("edits")),
    )


@lru_cache(_MOST_RECORDINGS)
def _pictured(path: Path, within: Path | None, files: _Files) -> bytes:
    """`files`: as in `_looked_at`."""
    with pf.read(path).playback(within=within) as playback:
        return playback.best_tile_jpeg(_WIDTH_PX)
