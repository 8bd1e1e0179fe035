"""Write a finished recording: the lossless result and every output that was asked for, whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from posefuse.app.config import TrackConfig
from posefuse.app.plugins import build_plugin
from posefuse.app.session import Session
from posefuse.core import Recording
from posefuse.files.atomic import atomic_folder
from posefuse.files.recording import write_recording

Progress = Callable[[int, int], None]


def write_outputs(
    recording: Recording, session: Session, config: TrackConfig, out: Path, progress: Progress
) -> dict[str, list[Path]]:
    """Write the result folder; returns the files by the name of what wrote them.

    Raises:
        PosefuseError: an output that is not there or cannot be written; nothing is left behind then.
    """
    sinks = {name: build_plugin("sinks", name, {}) for name in config.outputs}
    steps = len(sinks) + 1
    with atomic_folder(out) as folder:
        written = {"recording": write_recording(folder, recording)}
        progress(1, steps)
        for name, sink in sinks.items():
            written[name] = sink.write(recording, folder)
            progress(len(written), steps)
    return {name: [out / path.relative_to(folder) for path in paths] for name, paths in written.items()}
