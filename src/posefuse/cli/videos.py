"""The folder that keeps what cameras saw: a session for `posefuse track` and `posefuse calibrate`."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from posefuse.core import InputError, PosefuseError, Rig, SourceError
from posefuse.formats.kept_video import VIDEOS_FOLDER
from posefuse.formats.rig import write_rig
from posefuse.foundation.output_folder import check_replaceable, find_unfinished, output_folder, read_mark
from posefuse.realtime.capture import LiveInput
from posefuse.realtime.video_keeping import KeptCounts, read_counts, write_found_counts

RIG_FILE = "rig.toml"
# a camera that is recorded writes more often
_IN_USE_S = 3
_RESUME = "posefuse record --resume --out {}"


def check_videos_folder(folder: Path, *, command: str) -> None:
    """Raise InputError unless videos can go to `folder`: it is free, and no recording of that name waits to be completed."""
    check_replaceable(folder, command=command, replace=False)
    if _interrupted(folder):
        again = _RESUME.format(folder)
        raise InputError(f"{folder}: a recording of this name was interrupted; `{again}` completes it, or choose another name")


def _interrupted(folder: Path) -> list[Path]:
    return [left for left in find_unfinished(folder) if _written(left / VIDEOS_FOLDER)]


def _written(videos: Path) -> list[Path]:
    return [path for path in sorted(videos.glob("*.mp4")) if path.stat().st_size]


@contextmanager
def kept_videos(
    folder: Path | None, rig: Rig | None, inputs: Sequence[LiveInput], *, command: str = "live"
) -> Iterator[Path | None]:
    """Where the videos go while the cameras run; complete in `folder` after it, with the rig. None: none are kept.

    A session that is killed leaves what was written in the staging folder next to it, see `completed_recording`.

    Raises:
        InputError: `folder` cannot be used, or cannot be completed; the message names where the videos are.
    """
    if folder is None:
        yield None
        return
    with output_folder(folder, command=command, keep_unfinished=True) as out:
        if rig is not None:
            write_rig(out.folder / RIG_FILE, rig.only(entry.camera for entry in inputs))
        videos = out.folder / VIDEOS_FOLDER
        videos.mkdir()
        try:
            yield videos
        except BaseException as error:
            if not _written(videos):
                shutil.rmtree(videos)
                (out.folder / RIG_FILE).unlink(missing_ok=True)
            elif isinstance(error, PosefuseError):
                error.add_note(f"what was recorded until then is kept; `{_RESUME.format(folder)}` completes it")
            raise


def completed_recording(folder: Path) -> dict[str, KeptCounts]:
    """Complete the videos of a program that was killed while it recorded to `folder`; what each camera's video holds, by name.

    Raises:
        InputError: there are none, they are still being written, or they cannot be moved to `folder`.
    """
    left = _interrupted(folder)
    if not left:
        raise InputError(f"{folder}: no recording of this name was interrupted; nothing to resume")
    staging = left[-1]
    videos, mark = staging / VIDEOS_FOLDER, read_mark(staging)
    assert mark is not None
    made = _written(videos)
    if any(abs(time.time() - path.stat().st_mtime) < _IN_USE_S for path in made):
        raise InputError(f"{folder}: {staging} was written to within the last {_IN_USE_S} s; is it still being recorded?")
    with output_folder(folder, command=mark.command, keep_unfinished=True, unfinished=staging):
        for path in made:
            write_found_counts(path)
        return read_counts(videos, [path.stem for path in made])


def check_recorded(videos: Path, counts: Mapping[str, KeptCounts], stopped: Sequence[str] = ()) -> None:
    """Where no camera delivered a frame raise SourceError, or KeyboardInterrupt after a request to stop."""
    if any(one.written or not (videos / f"{name}.json").is_file() for name, one in counts.items()):
        return
    if stopped:
        raise KeyboardInterrupt
    raise SourceError(f"no frame came from {', '.join(counts)}: nothing was recorded; are the cameras switched on?")


def video_figures(counts: Mapping[str, KeptCounts]) -> dict[str, Any]:
    """Frames written and lost, rate and longest gap, by camera."""
    return {name: {**asdict(one), "dropped": one.dropped, "rate_hz": one.rate_hz} for name, one in counts.items()}
