"""`posefuse calibrate clocks`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from .calibrate_options import MOST_S, MostSeconds, OptionalFile, RateHz, ReportOptions
from .options import Figures, InputKind, NetworkOptions, Shown, positive


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ClockOptions:
    """How the clock offsets are found."""

    rig: OptionalFile = None
    """Calibration file, when it is not in SESSION."""
    input: InputKind | None = None
    """Which data of the session to use."""
    clocks: Literal["offset", "drift"] = "offset"
    """Whether to estimate a drift (a different clock rate) as well."""
    rate_hz: RateHz = None
    """Frame rate of 2D poses and images that state none."""
    seconds: Annotated[float, Parameter(metavar="S"), positive(MOST_S)] = 60.0
    """Use so many seconds from the middle of the recording."""
    most_s: MostSeconds = 10.0


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
