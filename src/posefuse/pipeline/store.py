"""Detections on disk while they are made, so that no end of the program loses them, and going on from them."""

from __future__ import annotations

import dataclasses
import hashlib
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse import __version__
from posefuse.core import DetectionBatch, InputError, Observations, Rig, Skeleton
from posefuse.formats.detection_log import LOG_FILE, ObservationLog, is_in_use, read_log
from posefuse.foundation.output_folder import MARK_FILE, find_unfinished
from posefuse.foundation.parsing import plain

from .opening import Opened

# settings that detections depend on: what the detector is, what it sees, and how people are followed from frame to frame
_SETTINGS = ("detector", "associate", "fuse", "start_s", "end_s", "rate_hz")
_OF_CAMERA = ("offset_s", "drift_ppm", "crop", "scale")


class DetectionStore:
    """The log of a run in the folder of its results; implements `run.Store`.

    Args:
        folder: with the log of an earlier run that did not end, or without. opened: the session to be tracked.

    Raises:
        InputError: the earlier run had other inputs or settings; names the first of them.
    """

    def __init__(self, folder: Path, opened: Opened) -> None:
        self._path, self._made_with = folder / LOG_FILE, detection_dependencies(opened)
        self._log: ObservationLog | None = None
        self._earlier = read_log(self._path) if self._path.exists() else None
        if self._earlier is not None:
            _check_same(self._earlier.made_with, self._made_with)

    def stored(self, skeleton: Skeleton, rig: Rig) -> Observations | None:
        """The time steps that the earlier run finished; opens the log, which continues after them."""
        batches, keep = self._earlier.whole_steps() if self._earlier is not None else ((), 0)
        self._log = ObservationLog(
            self._path, skeleton=skeleton, camera_names=rig.names, made_with=self._made_with, keep=keep
        )  # fmt: skip
        return Observations.from_batches(skeleton, rig.names, batches) if batches else None

    def append(self, batch: DetectionBatch) -> None:
        """Keep one more answer; raises InputError when the disk does not take it."""
        assert self._log is not None, "opened by `stored`"
        self._log.append(batch)

    def close(self) -> None:
        """Close the log, which stays."""
        if self._log is not None:
            self._log.close()

    def discard(self) -> None:
        """Remove the log: its detections are part of a finished result, or can give none."""
        self.close()
        self._path.unlink(missing_ok=True)


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


def remove_unfinished(out: Path) -> None:
    """Remove what interrupted runs left, which posefuse wrote alone."""
    for folder in find_unfinished(out):
        shutil.rmtree(folder, ignore_errors=True)


def keep_log_only(folder: Path) -> None:
    """Remove the half-written results of an interrupted run from its staging folder; its detections stay."""
    for entry in folder.iterdir():
        if entry.name in (LOG_FILE, MARK_FILE):
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def detection_dependencies(opened: Opened) -> dict[str, Any]:
    """What the detections of a session depend on, by name, as plain values."""
    config, session = dataclasses.asdict(opened.config), opened.session
    used = [entry for entry in session.inputs if entry.camera in opened.rig.names]
    values: dict[str, Any] = {"version of posefuse": __version__, "rig": _rig_digest(opened.rig)}
    values |= {f"data of camera {entry.camera}": _content_of(entry.path) for entry in used}
    values |= {f"depth of camera {entry.camera}": _content_of(entry.depth) for entry in used if entry.depth is not None}
    for entry in used:
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


def _rig_digest(rig: Rig) -> str:
    digest = hashlib.sha256()
    for camera in rig:
        pose = camera.cam_from_world
        numbers = [camera.size_wh, camera.K.ravel(), camera.distortion, pose.wxyz, pose.xyz, [camera.readout_s]]
        digest.update(f"{camera.name}|{camera.model}|".encode())
        digest.update(np.concatenate([np.asarray(part, "<f8") for part in numbers]).tobytes())
    return digest.hexdigest()


def _check_same(before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    changed = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    if changed:
        name = changed[0]
        more = f" ({len(changed) - 1} more changed)" if len(changed) > 1 else ""
        raise InputError(
            f"`resume=True`: {name} has changed since the detections were made: {before.get(name)}, now {now.get(name)}{more}; "
            "use what was used then, or `replace=True` to start from the beginning"
        )
