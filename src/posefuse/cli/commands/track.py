"""`posefuse track`: a session folder to a 3D result."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Group, Parameter
from cyclopts.validators import MutuallyExclusive

from .options import Figures, InputKind, SettingsOptions, Shown, xy_from_text

_AGAIN = Group("Earlier work in DIR", validator=MutuallyExclusive(), sort_key=-1)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class TrackOptions:
    """What `posefuse track` reads and makes."""

    out: Annotated[Path, Parameter(metavar="DIR")]
    """Folder for the result; must not exist, unless with --force or --resume."""
    rig: Annotated[str | None, Parameter(metavar="FILE")] = None
    """Calibration file, relative to SESSION."""
    input: InputKind | None = None
    """Which data of the session to use."""
    weights: Literal["none", "score", "all", "robust"] | None = None
    """How the views are weighted (default robust)."""
    raw: bool = False
    """Write every time step as it was fused: no smoothing, no filled gaps."""
    person: Annotated[
        tuple[float, float] | None,
        Parameter(metavar="X,Y", n_tokens=1, converter=xy_from_text, accepts_keys=False, allow_leading_hyphen=True),
    ] = None
    """Follow the person nearest to this place, in metres in world coordinates."""
    start: Annotated[float | None, Parameter(metavar="S")] = None
    """Begin at this time of the session, in seconds."""
    end: Annotated[float | None, Parameter(metavar="S")] = None
    """End at this time of the session, in seconds."""
    rate: Annotated[float | None, Parameter(metavar="HZ")] = None
    """Output rate; also the frame rate of images and 2D poses that state none."""
    outputs: Annotated[str | None, Parameter(metavar="A,B,...")] = None
    """Which files to write; `posefuse plugins` lists them."""
    view: bool = False
    """Open the result in the Rerun viewer (extra: viewer)."""
    force: Annotated[bool, Parameter(group=_AGAIN)] = False
    """Replace the results in DIR, and start interrupted work anew."""
    resume: Annotated[bool, Parameter(group=_AGAIN)] = False
    """Continue where the same command was interrupted."""


def track(
    session: Annotated[Path, Parameter()],
    /,
    *,
    options: TrackOptions,
    settings: SettingsOptions = SettingsOptions(),
    terminal: Shown,
) -> Figures:
    """Turn a session (calibration + videos, image folders or 2D poses) into a 3D skeleton and write its files.

    Args:
        session: Folder with a calibration file and the recordings.
    """
    from posefuse.cli.tracking import track_session

    return track_session(session, options, settings, terminal)
