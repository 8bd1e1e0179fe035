"""`posefuse calibrate clocks`."""

from __future__ import annotations

from pathlib import Path

from posefuse.cli.options.calibration import ClockOptions, ReportOptions
from posefuse.cli.options.shared import Figures, NetworkOptions, Shown


def calibrate_clocks(
    session: Path,
    /,
    *,
    options: ClockOptions = ClockOptions(),
    files: ReportOptions = ReportOptions(),
    networks: NetworkOptions = NetworkOptions(),
    terminal: Shown,
) -> Figures:
    """Find the clock offsets of calibrated cameras that are not synchronised, from a person who moves.

    Args:
        session: As for `posefuse track`: a folder with the calibration file and the recordings.
    """
    from posefuse.cli.calibrating.person_steps import clocks

    return clocks(session, options, files, networks, terminal)
