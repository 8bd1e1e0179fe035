"""`posefuse track`: a session folder to a 3D result."""

from __future__ import annotations

from pathlib import Path

from posefuse.cli.options.shared import Figures, SettingsOptions, Shown
from posefuse.cli.options.track import TrackOptions


def track(
    session: Path,
    /,
    *,
    options: TrackOptions,
    settings: SettingsOptions = SettingsOptions(),
    terminal: Shown,
) -> Figures:
    """Turn a session (calibration + videos, image folders or 2D poses) into a 3D skeleton and write its files.

    Args:
        session: Folder with a calibration file and the recordings; or a result, or the .mcap of `posefuse live --record`, to
            solve again without detecting.
    """
    from posefuse.pipeline.reading import is_live, is_result

    if is_live(session) or is_result(session):
        from posefuse.cli.second_solve import second_solve

        return second_solve(session, options, settings, terminal)
    from posefuse.cli.tracking import track_session

    return track_session(session, options, settings, terminal)
