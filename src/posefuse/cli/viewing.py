"""What `posefuse view` and `posefuse track --view` do: the result in the viewer, with the session's images if they are there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from posefuse.outputs.rerun import FILE, open_in_viewer, view_recording
from posefuse.outputs.rerun_scene import check_rerun
from posefuse.pipeline.reading import read_result
from posefuse.pipeline.writing import nearby_session, session_frames, session_of_recording

from .terminal import Terminal


def view_result(
    result: Path, session: Path | None, terminal: Terminal, open_viewer: Callable[[Path], None] = open_in_viewer
) -> Path:
    """Show a result until the viewer is closed; returns what was shown, see `view_recording`.

    Args:
        result: folder, or .mcap of a live session. session: it was made from; None: looked for by its name near the result.

    Raises:
        DependencyError: no Rerun SDK or no display. InputError: not a result, or not its session.
    """
    check_rerun()
    if session is None and (result / FILE).is_file():
        return view_recording(result, open_viewer=open_viewer)
    recording = read_result(result, terminal.warn)
    found = nearby_session(recording, result) if session is None else session_of_recording(recording, session)
    if found is None:
        name = recording.provenance.get("session", "unnamed")
        terminal.note(f"shown without images: no session {name} near {result} or here; --session FOLDER names it")
        return view_recording(result, open_viewer=open_viewer, read=lambda _: recording)
    with terminal.progress(f"images of {found.folder}") as advance:
        frames = session_frames(recording, found, advance)
        return view_recording(result, frames, open_viewer, read=lambda _: recording)
