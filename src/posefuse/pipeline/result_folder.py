"""A session tracked into a result folder: the detections are on disk as soon as they exist, the outputs follow."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from posefuse.core import InputError, Progress, Sink
from posefuse.formats.detection_log import LOG_FILE
from posefuse.foundation.output_folder import check_replaceable, output_folder
from posefuse.foundation.places import check_outside_inputs, check_space

from .clock import StageClock
from .config import TrackConfig
from .opening import Opened, open_session
from .run import Tracked, track_opened
from .session import Session
from .store import DetectionStore, keep_log_only, remove_unfinished, unfinished_work
from .writing import build_sinks, estimated_result_bytes, session_frames, write_result

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


def check_result_folder(session: Session, config: TrackConfig, out: ResultFolder) -> None:
    """Check the outputs and everything about the folder before any work is done.

    Raises:
        ConfigError: an output that does not exist, or an option that it does not take.
        InputError: the folder holds anything that may not be replaced, overlaps the session, holds interrupted work and
            neither `resume` nor `force` was given, or holds none and `resume` was.
    """
    build_sinks(config.outputs)
    check_outside_inputs(out.path, session.files)
    check_replaceable(out.path, command="track", replace=out.replace)
    _unfinished(out)


def track_into(
    session: Session,
    config: TrackConfig,
    out: ResultFolder,
    clock: StageClock,
    progress: Progress,
    warn: Warn,
    *,
    solve_interrupted: bool = True,
) -> Tracked:
    """Detect, solve and write; reports the stages ``detect`` and ``write``.

    Args:
        solve_interrupted: on Ctrl-C solve and write what was detected; otherwise keep the detections and raise.

    Raises:
        KeyboardInterrupt: Ctrl-C, when nothing can or should be solved.
        PosefuseError: anything that leaves no result; the detections made so far are kept where another attempt can use them.
    """
    check_result_folder(session, config, out)
    with clock.stage("open"):
        opened = open_session(session, config, warn)
    with closing(opened):
        sinks = build_sinks(config.outputs, opened.skeleton)
        return _opened_into(opened, sinks, out, clock, progress, warn, solve_interrupted=solve_interrupted)


def _opened_into(
    opened: Opened,
    sinks: Sequence[Sink],
    out: ResultFolder,
    clock: StageClock,
    progress: Progress,
    warn: Warn,
    *,
    solve_interrupted: bool,
) -> Tracked:
    note = lambda line: progress("detect", 0, None, line)  # noqa: E731
    unfinished, session = _unfinished(out), opened.session
    with (
        _kept(out, note),
        output_folder(
            out.path,
            command="track",
            inputs=session.files,
            replace=out.replace,
            estimated_bytes=estimated_result_bytes(opened, 1),
            keep_unfinished=True,
            unfinished=unfinished,
        ) as folder,
    ):
        if out.resume and unfinished is None and out.replace:
            shutil.copyfile(out.path / LOG_FILE, folder.folder / LOG_FILE)
        with closing(DetectionStore(folder.folder, opened)) as store:
            keep_log_only(folder.folder)
            detected = lambda done, total: progress("detect", done, total)  # noqa: E731
            tracked = track_opened(opened, clock, detected, note, warn, store, solve_interrupted=solve_interrupted)
            recording = tracked.recording
            if tracked.interrupted:
                steps = len(recording.poses)
                warn(f"stopped early; the first {steps} time steps are finished and kept; `resume=True` continues from them")
            check_space(folder.folder, estimated_result_bytes(opened, len(recording.poses.person_id)))
            with clock.stage("write"):
                frames = session_frames(recording, session, lambda done, total: progress("write", done, total), opened.config)
                files, failed = write_result(recording, frames, sinks, folder)
            for name, reason in failed.items():
                warn(f"output {name}: not written ({reason})")
            if not tracked.interrupted:
                store.discard()
            return replace(tracked, files=files, failed=failed)


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
