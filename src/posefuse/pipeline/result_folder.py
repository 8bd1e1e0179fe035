"""The folder of a result, and the detections that a run keeps in it while they are made, so that no end of it loses them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from posefuse import __version__
from posefuse.core import DetectionBatch, InputError, Observations, Progress
from posefuse.formats.detection_log import LOG_FILE, ObservationLog, is_in_use, read_log
from posefuse.formats.recording import rig_values
from posefuse.foundation.output_file import check_outside_inputs
from posefuse.foundation.output_folder import MARK_FILE, OutputFolder, check_replaceable, find_unfinished, output_folder
from posefuse.foundation.parsing import plain

from .config import TrackConfig
from .opening import Opened
from .session import Session
from .writing import build_sinks, estimated_result_bytes

KEPT = "the detections made so far are kept; the same again with `resume=True` continues from them"
# settings that detections depend on: what the detector is, what it sees, and how people are followed from frame to frame
_SETTINGS = ("detector", "associate", "fuse", "start_s", "end_s", "rate_hz")
_OF_CAMERA = ("offset_s", "drift_ppm", "crop", "scale")


@dataclasses.dataclass(frozen=True, kw_only=True)
class ResultFolder:
    """The folder of a result, and what may happen to existing files in it.

    Attributes:
        path: new or empty folder. force: move an older result aside, and drop interrupted work.
        resume: continue the detections of a run that was interrupted; from the beginning where it had none yet.
    """

    path: Path
    force: bool = False
    resume: bool = False

    @property
    def replace(self) -> bool:
        """Whether an older result may be moved aside: as the interrupted run that is continued was allowed to."""
        return self.force or (self.resume and unfinished_work(self.path) is not None)

    def check(self, session: Session, config: TrackConfig) -> None:
        """Check the outputs and everything about the folder before any work is done.

        Raises:
            ConfigError: an output that does not exist, or an option that it does not take.
            InputError: the folder holds anything that may not be replaced, overlaps the session, or holds interrupted work and
                neither `resume` nor `force` was given.
        """
        build_sinks(config.outputs)
        check_outside_inputs(self.path, session.files)
        check_replaceable(self.path, command="track", replace=self.replace)
        self._unfinished()

    @contextmanager
    def made(self, opened: Opened, progress: Progress) -> Iterator[tuple[OutputFolder, DetectionStore]]:
        """The folder to fill, and the store of its detections; these are kept when the block ends early, for whatever reason.

        Raises:
            InputError: as `check`; or the detections to continue were made from other inputs or with other settings.
        """
        unfinished = self._unfinished()
        if self.resume and unfinished is None:
            progress("detect", 0, None, "nothing to resume: starts from the beginning")
        try:
            with (
                output_folder(
                    self.path,
                    command="track",
                    inputs=opened.session.files,
                    replace=self.replace,
                    estimated_bytes=estimated_result_bytes(opened, 1),
                    keep_unfinished=True,
                    unfinished=unfinished,
                ) as folder,
                closing(DetectionStore(folder.folder, opened)) as store,
            ):
                yield folder, store
            # not before the result is in its place: what ends the program there would lose both
            (folder.target / LOG_FILE).unlink(missing_ok=True)
        except BaseException:
            if unfinished_work(self.path) is not None:
                progress("detect", 0, None, KEPT)
            raise

    def _unfinished(self) -> Path | None:
        """The folder to continue in; None where there is none, or where the work starts from the beginning."""
        found = unfinished_work(self.path)
        if self.force:
            for folder in find_unfinished(self.path):
                shutil.rmtree(folder, ignore_errors=True)
            return None
        if found is not None and not self.resume:
            raise InputError(
                f"{self.path}: an earlier run was interrupted; `resume=True` continues it, `replace=True` starts from the "
                "beginning"
            )
        return found


def unfinished_work(out: Path) -> Path | None:
    """The newest staging folder with detections that a run left when it was interrupted while it made `out`.

    Raises:
        InputError: another process is at work for `out` now.
    """
    found = [folder for folder in find_unfinished(out) if (folder / LOG_FILE).is_file()]
    for folder in found:
        if is_in_use(folder / LOG_FILE):
            raise InputError(f"{out}: another run is making these results now, in {folder}; wait for it to end")
    return found[-1] if found else None


class DetectionStore:
    """The detections of a run in the folder of its results.

    Args:
        folder: with the log of an earlier run that did not end, of whose files only the log stays, or without.
        opened: the session to be tracked.

    Attributes:
        stored: the time steps that the earlier run finished, after which the log continues; None: it finished none.

    Raises:
        InputError: the earlier run had other inputs or settings; names the first of them.
    """

    def __init__(self, folder: Path, opened: Opened) -> None:
        self._path, made_with = folder / LOG_FILE, detection_dependencies(opened)
        earlier = read_log(self._path) if self._path.exists() else None
        if earlier is not None:
            _check_same(earlier.made_with, made_with)
        batches, keep = earlier.whole_steps() if earlier is not None else ((), 0)
        names = opened.rig.names
        self._log = ObservationLog(
            self._path, skeleton=opened.skeleton, camera_names=names, made_with=made_with, keep=keep
        )  # fmt: skip
        self.stored = Observations.from_batches(opened.skeleton, names, batches) if batches else None
        for entry in folder.iterdir():
            if entry.is_dir() and not entry.is_symlink():
                shutil.rmtree(entry)
            elif entry.name not in (LOG_FILE, MARK_FILE):
                entry.unlink()

    def append(self, batch: DetectionBatch) -> None:
        """Keep one more answer, unless it is stored; raises InputError when the disk does not take it."""
        if self.stored is None or batch.step >= len(self.stored.step_t_ns):
            self._log.append(batch)

    def close(self) -> None:
        """Close the log, which stays."""
        self._log.close()

    def discard(self) -> None:
        """Remove the log: its detections can give no result."""
        self.close()
        self._path.unlink(missing_ok=True)


def detection_dependencies(opened: Opened) -> dict[str, Any]:
    """What the detections of a session depend on, by name, as plain values."""
    config, session = dataclasses.asdict(opened.config), opened.session
    rig = hashlib.sha256(json.dumps(rig_values(opened.rig)).encode()).hexdigest()
    values: dict[str, Any] = {"version of posefuse": __version__, "rig": rig}
    for entry in session.inputs:
        if entry.camera not in opened.rig.names:
            continue
        values[f"data of camera {entry.camera}"] = _content_of(entry.path)
        if entry.depth is not None:
            values[f"depth of camera {entry.camera}"] = _content_of(entry.depth)
        values |= {f"setting cameras.{entry.camera}.{name}": getattr(entry.settings, name) for name in _OF_CAMERA}
    for name in _SETTINGS:
        value = config[name]
        parts = {f"{name}.{key}": inner for key, inner in value.items()} if isinstance(value, dict) else {name: value}
        values |= {f"setting {part}": inner for part, inner in parts.items()}
    settled: dict[str, Any] = plain(values)
    return settled


def _content_of(path: Path) -> str:
    """Name, size and date: enough to notice another file without reading hours of video."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    about = [file.stat() for file in files]
    newest_ns = max((one.st_mtime_ns for one in about), default=0)
    return f"{path.name}, {len(files)} files, {sum(one.st_size for one in about)} bytes, changed {newest_ns}"


def _check_same(before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    changed = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    if changed:
        name = changed[0]
        more = f" ({len(changed) - 1} more changed)" if len(changed) > 1 else ""
        raise InputError(
            f"`resume=True`: {name} has changed since the detections were made: {before.get(name)}, now {now.get(name)}{more}; "
            "use what was used then, or `replace=True` to start from the beginning"
        )
