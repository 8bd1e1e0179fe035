"""The videos that were kept during a live session, on the time of its recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from posefuse.core import PosefuseError, Recording
from posefuse.formats.kept_video import VIDEOS_FOLDER, read_kept_times

from .session import Input, Session, find_session
from .session_images import lies_in, nearby_session
from .solve import config_of


def session_with_videos(recording: Recording, path: Path, within: Path | None = None) -> Session | None:
    """The session that shows a recording, of `posefuse track` or live; None where there is none.

    Args:
        path: of the recording, or of its second solve.
        within: a folder that the session and its files must lie in; None: anywhere.
    """
    if not recording.is_live and not recording.provenance.get("second_solve"):
        return nearby_session(recording, path, within)
    # in the recording's own folder, or in one next to it; a second solve is a folder next to that of the recording
    folders = (path.parent, *sorted(place.parent for place in path.parent.glob(f"*/{VIDEOS_FOLDER}")))
    found = (_kept(recording, folder, within) for folder in folders if (folder / VIDEOS_FOLDER).is_dir())
    return next((session for session in found if session is not None), None)


def _kept(recording: Recording, folder: Path, within: Path | None) -> Session | None:
    """The videos in a folder, if they were kept while the recording was made; each with the offset to its time."""
    try:
        session = find_session(folder, config_of(recording))
    except PosefuseError:
        return None
    inputs = tuple(_in_time(recording, session))
    if len(inputs) < len(session.inputs) or not inputs or (within is not None and not lies_in(session, within)):
        return None
    return replace(session, inputs=inputs)


def _in_time(recording: Recording, session: Session) -> Iterator[Input]:
    """Cameras of the recording whose videos overlap with it, with the times of the recording."""
    start_ns, end_ns = recording.provenance.get("start_ns"), int(recording.poses.t_ns[-1])
    for entry in session.inputs:
        kept = read_kept_times(entry.path) if entry.kind == "videos" else None
        if kept is None or not isinstance(start_ns, int) or entry.camera not in recording.rig.names:
            return
        offset_ns = kept.zero_ns - start_ns
        if offset_ns + kept.first_ns <= end_ns and offset_ns + kept.last_ns >= 0:
            yield replace(entry, settings=replace(entry.settings, offset_s=offset_ns / 1e9, drift_ppm=0.0))
