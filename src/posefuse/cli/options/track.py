"""Options of `posefuse track`."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import ArgumentCollection, Group, Parameter

from .shared import InputKind, people_from_text, xy_from_text

EXCLUDED = re.compile(r"(?:(?P<camera>.+):)?(?P<start>-?\d+(?:\.\d*)?)-(?P<end>-?\d+(?:\.\d*)?)")


def _one_of_two(arguments: ArgumentCollection) -> None:
    given = [argument.name for argument in arguments if argument.has_tokens]
    if len(given) > 1:
        raise ValueError(f"expected one of {', '.join(given)}, got both")


def _check_excluded(_: object, texts: tuple[str, ...]) -> None:
    for text in texts:
        if not EXCLUDED.fullmatch(text):
            raise ValueError(f"expected CAMERA:START-END or START-END in seconds, e.g. cam02:1.5-2.5, got {text!r}")


def _check_id(_: object, value: int | None) -> None:
    if value is not None and value < 0:
        raise ValueError(f"expected a person's id, from 0 on, got {value}")


_SOLVE_AGAIN = Group("When SESSION is a result or the .mcap of a live session", sort_key=-2)
_AGAIN = Group("Earlier work in DIR", validator=_one_of_two, sort_key=-1)


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
    body: Literal["auto", "on", "off"] | None = None
    """Fit one skeleton of constant lengths per person (default auto: people with hidden limbs)."""
    refine_rig: bool = False
    """Refine the cameras' poses slightly from the people, then solve again."""
    people: Annotated[int | None, Parameter(metavar="N", converter=people_from_text, n_tokens=1, accepts_keys=False)] = None
    """How many people to follow, the best seen ones: a number, or all (default 1)."""
    names: Annotated[str | None, Parameter(metavar="A,B,...")] = None
    """Names of the people in the order of their ids, for videos, reports and file names."""
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
    exclude: Annotated[tuple[str, ...], Parameter(metavar="[CAMERA:]A-B", group=_SOLVE_AGAIN, validator=_check_excluded)] = ()
    """Leave out a camera, or without a name all of them, from second A to B. May be given several times."""
    keep_person: Annotated[int | None, Parameter(metavar="ID", group=_SOLVE_AGAIN, validator=_check_id)] = None
    """Keep only this person."""
    no_edits: Annotated[bool, Parameter(group=_SOLVE_AGAIN)] = False
    """Ignore earlier marks: leave out nothing, keep all people."""
    force: Annotated[bool, Parameter(group=_AGAIN)] = False
    """Replace the results in DIR, and start interrupted work from the beginning."""
    resume: Annotated[bool, Parameter(group=_AGAIN)] = False
    """Continue where the same command was interrupted."""
