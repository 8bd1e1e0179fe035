"""What `posefuse demo` does."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.options.shared import SettingsOptions
from posefuse.cli.options.track import TrackOptions
from posefuse.pipeline.demo_clip import clip_folder

from .terminal import Terminal


def track_demo(out: Path, force: bool, terminal: Terminal) -> Mapping[str, Any]:
    """What `posefuse track` makes of the clip; returns its figures."""
    from .tracking import track_session

    clip = clip_folder()
    terminal.note(f"the clip lies in {clip}; the same as: posefuse track {clip} --out {out}")
    figures = track_session(clip, TrackOptions(out=out, force=force), SettingsOptions(), terminal)
    terminal.next(f"open {out / 'overlay.mp4'}", "all four views with the skeleton drawn in")
    terminal.next(
        "posefuse track SESSION --out RESULT", "your own recording: a folder with a calibration file and one video per camera"
    )
    return figures
