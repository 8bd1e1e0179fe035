"""Write a finished recording: the lossless result first, then every output that was asked for; and its report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Literal

import numpy as np

from posefuse.core import ConfigError, Frame, InputError, PosefuseError, Progress, Recording, Sink, SourceError, silent
from posefuse.core.errors import warn_caller
from posefuse.evaluation.biomechanics import BiomechanicsSettings, write_biomechanics
from posefuse.evaluation.report import TITLE
from posefuse.formats.recording import write_recording
from posefuse.foundation.output_folder import OutputFolder, output_folder
from posefuse.foundation.parsing import one_line
from posefuse.foundation.plugins import build_plugin
from posefuse.outputs.frames import FrameSink, write_each
from posefuse.sources import CountedSource

from .opening import Opened, build_source
from .reading import files_of_result, is_live
from .session import Session, find_session
from .solve import config_of
from .time_steps import decoded

# The images a recording was made from, found again: for viewers of results that do not hold them.

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
    session = find_session(folder, config_of(recording.provenance))
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
    recording: Recording, session: Session, progress: Progress, stage: str = "write"
) -> Iterator[tuple[int, tuple[Frame | None, ...]]]:
    """The session's frames at the recording's time steps, decoded again; nothing where the session has no images.

    Args:
        recording: a result. session: it was made from. progress: of this stage, called with time steps done and in all.
    """
    config = config_of(recording.provenance)
    inputs = [entry for entry in session.inputs if entry.camera in recording.rig.names and entry.kind != "pose2d"]
    if not inputs:
        return
    t_ns = recording.poses.t_ns
    period_ns = int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 1_000_000_000
    sources = [CountedSource(build_source(entry, config, len(inputs)), int(t_ns[0]) - period_ns) for entry in inputs]
    with closing(decoded(sources, int(t_ns[0]), period_ns, int(t_ns[-1]), _reported_already)) as sets:
        for done, one in enumerate(sets, start=1):
            yield one.t_ns, one.frames
            progress(stage, done, len(t_ns))


def _reported_already(camera: str, error: SourceError) -> None:
    """A camera that breaks off did so in tracking too, and was reported there."""


def build_sinks(outputs: Sequence[str] | Mapping[str, Mapping[str, Any]]) -> list[Sink]:
    """The outputs of these names, each once, with its options where it has some.

    Raises:
        ConfigError: one that does not exist, or an option that it does not take; before any work is done.
    """
    options = outputs if isinstance(outputs, Mapping) else dict[str, Mapping[str, Any]]()
    return [build_plugin("outputs", name, options.get(name, {})) for name in dict.fromkeys(outputs)]


def write_result(
    recording: Recording,
    session: Session | None,
    sinks: Sequence[Sink],
    out: OutputFolder,
    progress: Progress,
    *,
    outputs_alone: bool = False,
) -> tuple[list[Path], dict[str, str]]:
    """Write the recording, then every output; returns the files where they lie at the end, and why outputs failed, by name.

    Args:
        session: whose images are drawn on; None: without images. progress: of the stage ``write``.
        outputs_alone: without the recording.

    Raises:
        InputError: the recording itself cannot be written.
    """
    try:
        written = [] if outputs_alone else write_recording(out.folder, recording)
    except OSError as error:
        raise InputError(f"{out.target}: the recording cannot be written ({error.strerror or error})") from None
    outcome = write_each(sinks, recording, out.folder, session_frames(recording, session, progress) if session else ())
    files = [out.final(path) for path in (*written, *outcome.files)]
    return files, {name: _reason(error) for name, error in outcome.failed.items()}


def warn_of_failures(failed: Mapping[str, str]) -> None:
    """One `UserWarning` for each output that was not written."""
    for name, reason in failed.items():
        warn_caller(f"output {name}: not written ({reason})")


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
        ConfigError: no such format, or none. InputError: the folder holds anything else, or what is needed cannot be written.
    """
    sinks, alone = build_sinks(formats), command == "export"
    if alone and not sinks:
        raise ConfigError("outputs: expected at least one of those that `posefuse plugins` lists, got none")
    if alone and session is None and any(isinstance(sink, FrameSink) for sink in sinks):
        progress("write", 0, None, "without images: no session of this recording is near; name it with `session=DIR`")
    with output_folder(path, command=command, inputs=inputs, replace=replace) as out:
        files, failed = write_result(recording, session, sinks, out, progress, outputs_alone=alone)
        if failed and not (alone and files):
            raise InputError("; ".join(f"{name}: {reason}" for name, reason in failed.items()))
        warn_of_failures(failed)
        return files, failed


def _reason(error: Exception) -> str:
    if isinstance(error, PosefuseError):
        return str(error)
    return error.strerror if isinstance(error, OSError) and error.strerror else f"{type(error).__name__}: {one_line(error)}"


# measured on the demo clip with room to spare: bytes per time step, person and keypoint, then per pixel of the video
_BYTES_PER_KEYPOINT = {"csv": 160, "trc": 40, "c3d": 25, "mcap": 400, "rerun": 400}
_RECORDING_BYTES_PER_KEYPOINT = 120
_VIEW_BYTES_PER_KEYPOINT = 2 * 16  # once in the log, once in the result
_OVERLAY_BYTES = 40_000


def estimated_result_bytes(opened: Opened, people: int) -> int:
    """About how much the result with so many people will take on disk."""
    config, keypoints = opened.config, len(opened.skeleton)
    per_keypoint = _RECORDING_BYTES_PER_KEYPOINT + _VIEW_BYTES_PER_KEYPOINT * len(opened.rig)
    per_keypoint += sum(_BYTES_PER_KEYPOINT.get(name, 0) for name in config.outputs)
    per_step = per_keypoint * keypoints * people + _OVERLAY_BYTES * ("overlay" in config.outputs)
    return opened.timeline.count * per_step


# The folder of a report next to the result that it is about.

FOLDER, PAGE_FILE = "biomechanics", "report.html"
# of all files together, measured on the bundled clip
_BYTES_PER_STEP_AND_PERSON = 6_000


def report_folder(result: Path) -> Path:
    """Where the report of a result lies unless asked otherwise: RESULT/biomechanics, or NAME_biomechanics for NAME.mcap."""
    return result.with_name(f"{result.stem}_{FOLDER}") if is_live(result) else result / FOLDER


def write_report_folder(
    recording: Recording,
    result: Path | None,
    folder: Path,
    settings: BiomechanicsSettings | None = None,
    *,
    title: str | None = None,
    progress: Progress = silent,
) -> list[Path]:
    """Write angles, gait, files for other programs and the page, an earlier report is moved aside; returns the files.

    Args:
        recording: what was read from `result`; None where it is in memory only.

    Raises:
        InputError: the folder holds anything else, or there is no one to report on.
    """
    size = len(recording.poses) * len(recording.poses.person_id) * _BYTES_PER_STEP_AND_PERSON
    inputs = [] if result is None else files_of_result(result)
    with output_folder(folder, command="report", inputs=inputs, replace=True, estimated_bytes=size) as place:
        made = write_biomechanics(recording, place.folder, settings, title=title or TITLE, progress=progress)
        relative = [path.relative_to(place.folder) for path in made]
    return [folder / path for path in relative]
