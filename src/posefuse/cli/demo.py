"""The bundled clip: four simulated cameras, a walking person."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.options.shared import SettingsOptions
from posefuse.cli.options.track import TrackOptions
from posefuse.core import InputError

from .terminal import Terminal

_PACKAGE = Path(__file__).resolve().parents[1]
# a wheel has the first seconds of the videos, and the rig; a checkout has all of it, with the exact truth
_PLACES = (_PACKAGE.parents[1] / "examples" / "demo", _PACKAGE / "demo_clip")


def clip_folder() -> Path:
    """The session folder of the clip; raises InputError when this installation has none."""
    for place in _PLACES:
        if (place / "rig.toml").is_file():
            return place
    raise InputError(f"the bundled clip is not in this installation (looked in {_PLACES[-1]}); reinstall posefuse")


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
