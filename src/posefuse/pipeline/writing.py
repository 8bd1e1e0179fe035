"""Write a finished recording: the lossless result and every output that was asked for, whole or not at all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from posefuse.core import Frame, Recording, Sink, SourceError
from posefuse.formats.recording import write_recording
from posefuse.foundation.atomic import atomic_folder
from posefuse.foundation.plugins import build_plugin
from posefuse.outputs.frames import write_outputs
from posefuse.sources import FramesAhead, frame_sets

from .config import TrackConfig
from .run import build_source
from .session import Session

Progress = Callable[[int, int], None]


def build_sinks(names: Sequence[str]) -> list[Sink]:
    """The outputs of these names; raises ConfigError for one that does not exist, before any work is done."""
    return [build_plugin("sinks", name, {}) for name in names]


def write_result(
    recording: Recording, session: Session, config: TrackConfig, sinks: Sequence[Sink], out: Path, progress: Progress
) -> list[Path]:
    """Write the result folder; returns its files.

    Raises:
        PosefuseError: an output that cannot be written; nothing is left behind then.
    """
    with atomic_folder(out) as folder:
        written = write_recording(folder, recording)
        written += write_outputs(sinks, recording, folder, _frames(recording, session, config, progress))
    return [out / path.relative_to(folder) for path in written]


def _frames(
    recording: Recording, session: Session, config: TrackConfig, progress: Progress
) -> Iterator[tuple[int, tuple[Frame | None, ...]]]:
    """The session's frames at the recording's instants, decoded again; nothing where the session has no images."""
    inputs = [entry for entry in session.inputs if entry.camera in recording.rig.names and entry.kind != "pose2d"]
    if not inputs:
        return
    t_ns = recording.poses.t_ns
    period_ns = int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 1_000_000_000
    streams = {entry.camera: FramesAhead(build_source(entry, config)) for entry in inputs}
    try:
        sets = frame_sets(streams, int(t_ns[0]), period_ns, int(t_ns[-1]), on_lost=_said_already)
        for done, one in enumerate(sets, start=1):
            yield one.t_ns, one.frames
            progress(done, len(t_ns))
    finally:
        for stream in streams.values():
            stream.close()


def _said_already(camera: str, error: SourceError) -> None:
    """A camera that breaks off did so in tracking too, and was reported there."""
