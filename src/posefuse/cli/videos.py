"""The folder in which `posefuse live --videos` keeps what its cameras saw: a session for `posefuse track`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from posefuse.core import Rig
from posefuse.formats.rig import write_rig
from posefuse.foundation.output_folder import output_folder
from posefuse.realtime.capture import LiveInput
from posefuse.realtime.video_keeping import VIDEOS_FOLDER, read_counts

RIG_FILE = "rig.toml"


@contextmanager
def kept_videos(folder: Path | None, rig: Rig, inputs: Sequence[LiveInput]) -> Iterator[Path | None]:
    """Where the videos go while the session runs; complete in `folder` after it, with the rig. None: none are kept.

    A session that is killed leaves what was written in the staging folder beside it.
    """
    if folder is None:
        yield None
        return
    with output_folder(folder, command="live", keep_unfinished=True) as out:
        write_rig(out.folder / RIG_FILE, rig.only(entry.camera for entry in inputs))
        videos = out.folder / VIDEOS_FOLDER
        videos.mkdir()
        yield videos


def video_figures(folder: Path, inputs: Sequence[LiveInput]) -> dict[str, Any]:
    """Frames written and dropped, by camera."""
    counts = read_counts(folder / VIDEOS_FOLDER, [entry.camera for entry in inputs])
    return {name: asdict(one) for name, one in counts.items()}
