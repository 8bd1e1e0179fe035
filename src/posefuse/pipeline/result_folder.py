"""A session tracked into a result folder: the detections are on disk as soon as they exist, the outputs follow."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from posefuse.core import InputError, Progress, Sink
from posefuse.formats.detection_log import LOG_FILE
from posefuse.foundation.output_folder import OutputFolder, check_replaceable, output_folder
from posefuse.foundation.places import check_outside_inputs, check_space

from .clock import StageClock
from .config import TrackConfig
from .opening import Opened, open_session
from .run import Tracked, track_opened
from .session import Session
from .store import DetectionStore, keep_log_only, remove_unfinished, unfinished_work
from .writing import estimated_result_bytes, write_result

Warn = Callable[[str], None]
KEPT = "the detections made so far are kept; the same again with `resume=True` continues from them"


@dataclass(frozen=True, kw_only=True)
class ResultFolder:
    """The folder of a result, and what may happen to existing files in it.

    Attributes:
        path: new or empty folder. force: move an older result aside, and drop interrupted work.
        resume: continue the detections of a run that was interrupted.
    """

    path: Path
    force: bool = False
    resume: bool = False

    @property
    def replace(self) -> bool:
        """Whether an older result may be replaced: a result that Ctrl-C cut short has its detections with it."""
        return self.force or (self.resume and (self.path / LOG_FILE).is_file())


@dataclass(frozen=True, kw_only=True)
class Written:
    """What was tracked, the files written, and why outputs failed, by name."""

    tracked: Tracked
    files: tuple[Path, ...]
    failed: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """A session and a folder that may be worked on; nothing was opened or written yet."""

    session: Session
    out: ResultFolder
    sinks: Sequence[Sink]
    inputs: tuple[Path, ...]
    unfinished: Path | None


def prepare(session: Session, sinks: Sequence[Sink], out: ResultFolder) -> Prepared:
    """Check everything about the folder before any work is done.

    Raises:
        InputError: the folder holds anything that may not be replaced, overlaps the session, holds interrupted work and
            neither `resume` nor `force` was given, or holds none and `resume` was.
    """
    inputs = (session.folder, session.rig_path, *(entry.path for entry in session.inputs))
    check_outside_inputs(out.path, inputs)
    check_replaceable(out.path, command="track", replace=out.replace)
    return Prepared(session=session, out=out, sinks=sinks, inputs=inputs, unfinished=_unfinished(out))


def track_into(
    prepared: Prepared,
    config: TrackConfig,
    clock: StageClock,
    progress: Progress,
    warn: Warn,
    *,
    solve_interrupted: bool = True,
) -> Written:
    """Detect, solve and write; reports the stages ``detect`` and ``write``.

    Args:
        solve_interrupted: on Ctrl-C solve and write what was detected; otherwise keep the detections and raise.

    Raises:
        KeyboardInterrupt: Ctrl-C, when nothing can or should be solved.
        PosefuseError: anything that leaves no result; the detections made so far are kept where another attempt can use them.
    """
    note = lambda line: progress("detect", 0, None, line)  # noqa: E731
    out = prepared.out
    with clock.stage("open"):
        opened = open_session(prepared.session, config, warn)
    with (
        closing(opened.steps),
        _kept(out, note),
        output_folder(
            out.path,
            command="track",
            inputs=prepared.inputs,
            replace=out.replace,
            estimated_bytes=estimated_result_bytes(opened, 1),
            keep_unfinished=True,
            unfinished=prepared.unfinished,
            warn=warn,
        ) as folder,
    ):
        if out.resume and prepared.unfinished is None and out.replace:
            shutil.copyfile(out.path / LOG_FILE, folder.folder / LOG_FILE)
        with closing(DetectionStore(folder.folder, opened)) as store:
            keep_log_only(folder.folder)
            detected = lambda done, total: progress("detect", done, total)  # noqa: E731
            tracked = track_opened(opened, clock, detected, note, warn, store, solve_interrupted=solve_interrupted)
            if tracked.interrupted:
                steps = len(tracked.recording.poses)
                warn(f"stopped early; the first {steps} time steps are finished and kept; `resume=True` continues from them")
            check_space(folder.folder, estimated_result_bytes(opened, len(tracked.recording.poses.person_id)))
            written = _write(tracked, opened, prepared.sinks, folder, clock, progress=progress, warn=warn)
            if not tracked.interrupted:
                store.discard()
            return written


def _write(
    tracked: Tracked,
    opened: Opened,
    sinks: Sequence[Sink],
    folder: OutputFolder,
    clock: StageClock,
    progress: Progress,
    warn: Warn,
) -> Written:
    drawn = lambda done, total: progress("write", done, total)  # noqa: E731
    with clock.stage("write"):
        files, failed = write_result(tracked.recording, opened.session, opened.config, sinks, folder, drawn)
    for name, reason in failed.items():
        warn(f"output {name}: not written ({reason})")
    return Written(tracked=tracked, files=tuple(files), failed=failed)


def _unfinished(out: ResultFolder) -> Path | None:
    """The folder to continue in; None where none is asked for, and where a result that was cut short has its detections."""
    found = unfinished_work(out.path)
    if out.force:
        remove_unfinished(out.path)
        return None
    if found is not None and not out.resume:
        raise InputError(
            f"{out.path}: an earlier run was interrupted; `resume=True` continues it, `replace=True` starts from the beginning"
        )
    if found is None and out.resume and not (out.path / LOG_FILE).is_file():
        raise InputError(f"{out.path}: nothing to resume: no interrupted work is there; is it the right folder?")
    return found


@contextmanager
def _kept(out: ResultFolder, note: Warn) -> Iterator[None]:
    """Report what is kept when the work stops before its end, for whatever reason."""
    try:
        yield
    except BaseException:
        if unfinished_work(out.path) is not None:
            note(KEPT)
        raise
