"""The images a recording was made from, found again: for viewers of results that do not hold them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from posefuse.core import Frame, InputError, PosefuseError, Recording, SourceError
from posefuse.sources import CountedSource, FramesAhead, frame_sets

from .config import TrackConfig
from .opening import build_source
from .session import Session, find_session
from .solve import config_of

Progress = Callable[[int, int], None]
# how many folders above a result are looked into for its session
_FOLDERS_UP = 3
# where the studio puts sessions, next to its folder of results
SESSIONS_FOLDER = "sessions"


def session_of_recording(recording: Recording, folder: Path) -> Session:
    """The session in `folder`, if the recording was made from it.

    Raises:
        InputError: the files of its cameras have other names than those of the recording. PosefuseError: no session there.
    """
    made_from = dict(recording.provenance.get("inputs") or {})
    session = find_session(folder, config_of(recording))
    found = {entry.camera: entry.path.name for entry in session.inputs}
    other = sorted(camera for camera in recording.rig.names if made_from.get(camera) != found.get(camera))
    if other:
        raise InputError(
            f"{folder}: not the session of this result: camera {other[0]} was made from {made_from.get(other[0], 'no file')}, "
            f"here it has {found.get(other[0], 'no file')}"
        )
    return session


def nearby_session(recording: Recording, result: Path, within: Path | None = None) -> Session | None:
    """The session of a recording, by its name in or next to the folders above the result, in their folder ``sessions``, and in
    the working folder.

    Args:
        within: a folder that the session and its files must lie in; None: anywhere.
    """
    name = str(recording.provenance.get("session") or "")
    above = [Path.cwd(), *result.resolve().parents[:_FOLDERS_UP]]
    places = (place for one in above for place in (one, one / name, one / SESSIONS_FOLDER / name))
    for folder in (place for place in places if name and place.name == name and place.is_dir()):
        try:
            session = session_of_recording(recording, folder)
        except PosefuseError:
            continue
        if within is None or lies_in(session, within):
            return session
    return None


def lies_in(session: Session, folder: Path) -> bool:
    """Whether all files of a session lie in a folder, links followed."""
    return all(path.resolve().is_relative_to(folder.resolve()) for path in session.files)


def session_frames(
    recording: Recording, session: Session, progress: Progress, config: TrackConfig | None = None
) -> Iterator[tuple[int, tuple[Frame | None, ...]]]:
    """The session's frames at the recording's time steps, decoded again; nothing where the session has no images.

    Args:
        recording: a result. session: it was made from. config: it was made with; None: the one of its provenance.
        progress: called with time steps done and in all.
    """
    config = config or config_of(recording)
    inputs = [entry for entry in session.inputs if entry.camera in recording.rig.names and entry.kind != "pose2d"]
    if not inputs:
        return
    t_ns = recording.poses.t_ns
    period_ns = int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 1_000_000_000
    sources = {entry.camera: build_source(entry, config, len(inputs)) for entry in inputs}
    streams = {name: FramesAhead(CountedSource(source, int(t_ns[0]) - period_ns)) for name, source in sources.items()}
    try:
        sets = frame_sets(streams, int(t_ns[0]), period_ns, int(t_ns[-1]), on_lost=_reported_already)
        for done, one in enumerate(sets, start=1):
            yield one.t_ns, one.frames
            progress(done, len(t_ns))
    finally:
        for stream in streams.values():
            stream.close()


def _reported_already(camera: str, error: SourceError) -> None:
    """A camera that breaks off did so in tracking too, and was reported there."""
