"""The folder that keeps what cameras saw: a session for `posefuse track` and `posefuse calibrate`."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from posefuse.core import InputError, Rig
from posefuse.formats.kept_video import VIDEOS_FOLDER
from posefuse.formats.rig import write_rig
from posefuse.foundation.output_folder import output_folder
from posefuse.realtime.capture import LiveInput
from posefuse.realtime.video_keeping import read_counts

RIG_FILE, RECORDING_FILE = "rig.toml", "recording.toml"


@contextmanager
def kept_videos(
    folder: Path | None, rig: Rig | None, inputs: Sequence[LiveInput], *, command: str = "live"
) -> Iterator[Path | None]:
    """Where the videos go while the cameras run; complete in `folder` after it, with the rig and facts. None: none are kept.

    A session that is killed leaves what was written in the staging folder next to it.

    Raises:
        InputError: `folder` cannot be used, or cannot be completed; the message names where the videos are.
    """
    if folder is None:
        yield None
        return
    begun = datetime.now(UTC)
    with output_folder(folder, command=command, keep_unfinished=True) as out:
        if rig is not None:
            write_rig(out.folder / RIG_FILE, rig.only(entry.camera for entry in inputs))
        videos = out.folder / VIDEOS_FOLDER
        videos.mkdir()
        yield videos
        try:
            (out.folder / RECORDING_FILE).write_text(_facts(videos, inputs, command, begun), encoding="utf-8")
        except OSError as error:
            reason = f"{RECORDING_FILE} cannot be written ({error.strerror})"
            raise InputError(f"{folder}: {reason}; the videos stay in {videos}") from None


def _facts(videos: Path, inputs: Sequence[LiveInput], command: str, begun: datetime) -> str:
    """What was recorded, as TOML."""
    lines = [
        f"# Videos of `posefuse {command}`. The presentation times of all frames are on one clock, which begins shortly after",
        "# `begun`: no clock offsets between the cameras are needed.",
        f'begun = "{begun.isoformat(timespec="milliseconds")}"',
    ]
    counts = read_counts(videos, [entry.camera for entry in inputs])
    for entry in inputs:
        one = counts[entry.camera]
        values = {"kind": entry.kind, "frames": one.written, "dropped": one.dropped, "rate_hz": round(one.rate_hz, 3),
                  "first_s": round(one.first_s, 6), "longest_gap_s": round(one.longest_gap_s, 6), "kept": one.how,
                  "fault": one.fault}  # fmt: skip
        lines += ["", f"[cameras.{json.dumps(entry.camera)}]", *(f"{key} = {json.dumps(value)}" for key, value in values.items())]
    return "\n".join(lines) + "\n"


def video_figures(videos: Path, inputs: Sequence[LiveInput]) -> dict[str, Any]:
    """Frames written and dropped, rate and longest gap, by camera; `videos` as `kept_videos` gives it."""
    counts = read_counts(videos, [entry.camera for entry in inputs])
    return {name: {**asdict(one), "rate_hz": one.rate_hz} for name, one in counts.items()}
