"""Write a finished recording: the lossless result first, then every output that was asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from posefuse.core import Frame, InputError, PosefuseError, Recording, Sink, SourceError
from posefuse.formats.recording import write_recording
from posefuse.foundation.output_folder import OutputFolder
from posefuse.foundation.plugins import build_plugin
from posefuse.outputs.frames import FrameSets, write_each
from posefuse.sources import FramesAhead, frame_sets

from .config import TrackConfig
from .opening import Opened, build_source
from .session import Session

Progress = Callable[[int, int], None]


def build_sinks(names: Sequence[str]) -> list[Sink]:
    """The outputs of these names; raises ConfigError for one that does not exist, before any work is done."""
    return [build_plugin("sinks", name, {}) for name in names]


def write_result(
    recording: Recording, session: Session, config: TrackConfig, sinks: Sequence[Sink], out: OutputFolder, progress: Progress
) -> tuple[list[Path], dict[str, str]]:
    """Write the recording, then every output; returns the files where they lie at the end, and why outputs failed, by name.

    Raises:
        InputError: the recording itself cannot be written.
    """
    return write_with_frames(recording, _frames(recording, session, config, progress), sinks, out)


def write_with_frames(
    recording: Recording, frame_sets: FrameSets, sinks: Sequence[Sink], out: OutputFolder
) -> tuple[list[Path], dict[str, str]]:
    """`write_result` with frames from elsewhere, or none.

    Raises:
        InputError: the recording itself cannot be written.
    """
    try:
        written = write_recording(out.folder, recording)
    except OSError as error:
        raise InputError(f"{out.target}: the recording cannot be written ({error.strerror or error})") from None
    outcome = write_each(sinks, recording, out.folder, frame_sets)
    files = [out.final(path) for path in (*written, *outcome.files)]
    return files, {name: _reason(error) for name, error in outcome.failed.items()}


def _reason(error: Exception) -> str:
    if isinstance(error, PosefuseError):
        return str(error)
    return error.strerror if isinstance(error, OSError) and error.strerror else f"{type(error).__name__}: {error}"


# measured on the demo clip with room to spare: bytes per time step, person and keypoint, then per pixel of the video
_BYTES_PER_KEYPOINT = {"csv": 160, "json": 90, "parquet": 70, "trc": 40, "c3d": 25, "mcap": 400, "rerun": 400}
_RECORDING_BYTES_PER_KEYPOINT = 120
_VIEW_BYTES_PER_KEYPOINT = 2 * 16  # once in the log, once in the result
_OVERLAY_BYTES = 40_000


def estimated_bytes(opened: Opened) -> int:
    """About how much the result will take on disk."""
    config, keypoints = opened.config, len(opened.steps.skeleton)
    per_keypoint = _RECORDING_BYTES_PER_KEYPOINT + _VIEW_BYTES_PER_KEYPOINT * len(opened.rig)
    per_keypoint += sum(_BYTES_PER_KEYPOINT.get(name, 0) for name in config.outputs)
    per_step = per_keypoint * keypoints * config.associate.max_people + _OVERLAY_BYTES * ("overlay" in config.outputs)
    return opened.timeline.count * per_step


def _frames(
    recording: Recording, session: Session, config: TrackConfig, progress: Progress
) -> Iterator[tuple[int, tuple[Frame | None, ...]]]:
    """The session's frames at the recording's time steps, decoded again; nothing where the session has no images."""
    inputs = [entry for entry in session.inputs if entry.camera in recording.rig.names and entry.kind != "pose2d"]
    if not inputs:
        return
    t_ns = recording.poses.t_ns
    period_ns = int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 1_000_000_000
    streams = {entry.camera: FramesAhead(build_source(entry, config)) for entry in inputs}
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
