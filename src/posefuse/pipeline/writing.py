"""Write a finished recording: the lossless result first, then every output that was asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

from posefuse.core import InputError, PosefuseError, Progress, Recording, Sink, Skeleton
from posefuse.formats.recording import write_recording
from posefuse.foundation.output_folder import OutputFolder, output_folder
from posefuse.foundation.plugins import build_plugin
from posefuse.outputs.frames import FrameSets, write_each

from .opening import Opened
from .session import Session
from .session_images import session_frames


@runtime_checkable
class SkeletonSink(Sink, Protocol):
    """An output that depends on the keypoints that there will be."""

    def check(self, skeleton: Skeleton) -> None:
        """Raise ConfigError where it cannot be written for this skeleton; asked before any work is done."""
        ...


def build_sinks(outputs: Sequence[str] | Mapping[str, Mapping[str, Any]], skeleton: Skeleton | None = None) -> list[Sink]:
    """The outputs of these names, each with its options where they have some.

    Args:
        skeleton: of the recording to be written, where it is known.

    Raises:
        ConfigError: one that does not exist, an option that it does not take, or keypoints that it cannot do with; before any
            work is done.
    """
    options = outputs if isinstance(outputs, Mapping) else dict[str, Mapping[str, Any]]()
    sinks: list[Sink] = [build_plugin("outputs", name, options.get(name, {})) for name in outputs]
    for sink in sinks:
        if skeleton is not None and isinstance(sink, SkeletonSink):
            sink.check(skeleton)
    return sinks


def write_result(
    recording: Recording, frame_sets: FrameSets, sinks: Sequence[Sink], out: OutputFolder, *, outputs_alone: bool = False
) -> tuple[list[Path], dict[str, str]]:
    """Write the recording, then every output; returns the files where they lie at the end, and why outputs failed, by name.

    Args:
        frame_sets: images to draw on; may be empty. outputs_alone: without the recording.

    Raises:
        InputError: the recording itself cannot be written.
    """
    try:
        written = [] if outputs_alone else write_recording(out.folder, recording)
    except OSError as error:
        raise InputError(f"{out.target}: the recording cannot be written ({error.strerror or error})") from None
    outcome = write_each(sinks, recording, out.folder, frame_sets)
    files = [out.final(path) for path in (*written, *outcome.files)]
    return files, {name: _reason(error) for name, error in outcome.failed.items()}


def export_recording(
    recording: Recording,
    path: Path,
    formats: Sequence[str],
    session: Session | None,
    *,
    command: Literal["track", "export"] = "export",
    replace: bool,
    progress: Progress,
    inputs: Sequence[Path] = (),
) -> tuple[list[Path], dict[str, str]]:
    """Write a folder with files of other formats; images are drawn on where there is a session.

    Returns:
        The files, and why outputs failed, by name.

    Args:
        command: ``track`` writes the recording itself, too, and needs every output; of ``export`` one is enough.
        replace: move an earlier folder of the same kind aside. inputs: files that must not be written over.

    Raises:
        ConfigError: no such format. InputError: the folder holds anything else, or what is needed cannot be written.
    """
    sinks, alone = build_sinks(formats, recording.poses.skeleton), command == "export"
    with output_folder(path, command=command, inputs=inputs, replace=replace) as out:
        report = lambda done, total: progress("write", done, total)  # noqa: E731
        frames = () if session is None else session_frames(recording, session, report)
        files, failed = write_result(recording, frames, sinks, out, outputs_alone=alone)
        if failed and not (alone and files):
            raise InputError(failures(failed))
        return files, failed


def failures(failed: Mapping[str, str]) -> str:
    """Outputs that failed and why, in one line."""
    return "; ".join(f"{name}: {reason}" for name, reason in failed.items())


def _reason(error: Exception) -> str:
    if isinstance(error, PosefuseError):
        return str(error)
    return error.strerror if isinstance(error, OSError) and error.strerror else f"{type(error).__name__}: {error}"


# measured on the demo clip with room to spare: bytes per time step, person and keypoint, then per pixel of the video
_BYTES_PER_KEYPOINT = {"csv": 160, "trc": 40, "c3d": 25, "mcap": 400, "rerun": 400}
_RECORDING_BYTES_PER_KEYPOINT = 120
_VIEW_BYTES_PER_KEYPOINT = 2 * 16  # once in the log, once in the result
_OVERLAY_BYTES = 40_000


def estimated_result_bytes(opened: Opened, people: int) -> int:
    """About how much the result with so many people will take on disk."""
    config, keypoints = opened.config, len(opened.steps.skeleton)
    per_keypoint = _RECORDING_BYTES_PER_KEYPOINT + _VIEW_BYTES_PER_KEYPOINT * len(opened.rig)
    per_keypoint += sum(_BYTES_PER_KEYPOINT.get(name, 0) for name in config.outputs)
    per_step = per_keypoint * keypoints * people + _OVERLAY_BYTES * ("overlay" in config.outputs)
    return opened.timeline.count * per_step
