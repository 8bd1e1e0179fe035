"""`posefuse demo`, `track`, `solve` and `batch`: sessions to 3D results."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import ArgumentCollection, Group, Parameter

import posefuse as pf
from posefuse.pipeline.config import TrackConfig

from .options import Figures, NetworkOptions, SettingsOptions, Shown, arguments_of, count, settings_options
from .terminal import Terminal, quoted

_MAKES = Group("Result", sort_key=-3)
_SOLVED = {
    "associate.max_people": "people N", "names": "names A,B,...", "associate.near_xy_m": "person X,Y", "start_s": "start S",
    "end_s": "end S", "body": "body", "outputs": "outputs A,B,...",
    "fuse.weights": "weights", "raw": "raw", "rate_hz": "rate HZ",
}  # fmt: skip
_EXCLUDED = re.compile(r"(?:(?P<camera>.+):)?(?P<start>-?\d+(?:\.\d*)?)-(?P<end>-?\d+(?:\.\d*)?)")


def _one_of_two(arguments: ArgumentCollection) -> None:
    given = [argument.name for argument in arguments if argument.has_tokens]
    if len(given) > 1:
        raise ValueError(f"expected one of {', '.join(given)}, got both")


def _check_excluded(_: object, texts: tuple[str, ...]) -> None:
    for text in texts:
        if not _EXCLUDED.fullmatch(text):
            raise ValueError(f"expected CAMERA:START-END or START-END in seconds, e.g. cam02:1.5-2.5, got {text!r}")


def _check_id(_: object, value: int | None) -> None:
    if value is not None and value < 0:
        raise ValueError(f"expected a person's id, from 0 on, got {value}")


_AGAIN = Group("Earlier work in DIR", validator=_one_of_two, sort_key=-1)


@dataclass(frozen=True, kw_only=True)
class TrackOptions(SettingsOptions, NetworkOptions):
    """What `posefuse track` makes.

    Attributes:
        out: Folder for the result; must not exist, unless with --force or --resume.
        replace: Replace the results in DIR, and start interrupted work from the beginning.
        resume: Continue where the same command was interrupted, or start.
    """

    out: Annotated[Path, Parameter(metavar="DIR", group=_MAKES)]
    replace: Annotated[bool, Parameter(group=_AGAIN)] = False
    resume: Annotated[bool, Parameter(group=_AGAIN)] = False


@dataclass(frozen=True, kw_only=True)
class SolveOptions(SettingsOptions):
    """What `posefuse solve` makes.

    Attributes:
        out: Folder for the new result; must not exist, unless with --force.
        replace: Replace the results in DIR.
        exclude: Leave out a camera, or without a name all of them, from second A to B. May be given several times. This and
            --keep-person take the place of what RESULT was made with.
        keep_person: Keep only this person.
    """

    out: Annotated[Path, Parameter(metavar="DIR", group=_MAKES)]
    replace: Annotated[bool, Parameter(group=_MAKES)] = False
    exclude: Annotated[tuple[str, ...], Parameter(metavar="[CAMERA:]A-B", validator=_check_excluded)] = ()
    keep_person: Annotated[int | None, Parameter(metavar="ID", validator=_check_id)] = None


@dataclass(frozen=True, kw_only=True)
class BatchOptions(SettingsOptions, NetworkOptions):
    """What `posefuse batch` makes, and where it runs.

    Attributes:
        out: Folder for the results; run the same command again to continue.
        no_report: Do not write joint angles, gait and the report of each trial.
        jobs: Trials at once (default: as many as the cores and the free memory allow).
        scheduler: Run the trials on this Dask cluster, e.g. tcp://host:8786 (extra: cluster). It must see the same folders.
        replace: Run trials again that were completed with other settings or from other files.
    """

    out: Annotated[Path, Parameter(metavar="DIR", group=_MAKES)]
    no_report: Annotated[bool, Parameter(group=_MAKES)] = False
    jobs: Annotated[int | None, Parameter(metavar="N", group=_MAKES), count(1024)] = None
    scheduler: Annotated[str | None, Parameter(metavar="ADDRESS", group=_MAKES)] = None
    replace: Annotated[bool, Parameter(group=_MAKES)] = False


@settings_options("options", TrackConfig, {"rig": "rig FILE", "input": "input", **_SOLVED})
def track(session: Path, /, *, options: TrackOptions, terminal: Shown) -> Figures:
    """Turn a session (calibration + videos, image folders or 2D poses) into a 3D skeleton and write its files.

    Args:
        session: Folder with a calibration file and the recordings.
    """
    with terminal.stages() as progress:
        made = pf.track(session, **arguments_of(pf.track, options), progress=progress)
    terminal.show(made.summary())
    _next(options.out, terminal)
    terminal.next(f"posefuse view {quoted(options.out)}", "the skeleton in the 3D viewer (extra: viewer)")
    return made.figures


@settings_options("options", TrackConfig, _SOLVED)
def solve(result: Path, /, *, options: SolveOptions, terminal: Shown) -> Figures:
    """Solve a result or a live recording again, without detecting: other settings, stretches left out, one person kept.

    Args:
        result: Folder written by `posefuse track`, or the .mcap of `posefuse live --record`.
    """
    edits = pf.Edits(exclusions=tuple(map(_exclusion, options.exclude)), person=options.keep_person)
    given = {**arguments_of(pf.solve, options), "edits": None if edits == pf.Edits() else edits}
    with terminal.stages() as progress:
        made = pf.solve(result, **given, progress=progress)
    terminal.show(made.summary())
    _next(options.out, terminal)
    terminal.next(f"posefuse compare {quoted(options.out)} {quoted(result)}", "how far the earlier result was from it")
    return made.figures


def _exclusion(text: str) -> "pf.Exclusion":
    found = _EXCLUDED.fullmatch(text)
    assert found is not None  # the option checked it
    return pf.Exclusion(camera=found["camera"], start_s=float(found["start"]), end_s=float(found["end"]))


def _next(out: Path, terminal: Terminal) -> None:
    terminal.next(f"posefuse report {quoted(out)}", "joint angles, gait, files for OpenSim and Blender, one page")


def demo(
    *, out: Annotated[Path, Parameter(metavar="DIR")] = Path("posefuse-demo"), force: bool = False, terminal: Shown
) -> Figures:
    """Track the bundled clip of four cameras: shows within a minute whether everything works.

    Args:
        out: Folder for the result.
        force: Replace DIR if it exists.
    """
    clip = pf.demo_session()
    terminal.note(f"the clip lies in {clip}; the same as: posefuse track {quoted(clip)} --out {quoted(out)}")
    figures = track(clip, options=TrackOptions(out=out, replace=force), terminal=terminal)
    terminal.next(f"open {out / 'overlay.mp4'}", "all four views with the skeleton drawn in")
    own = "your own recording: a folder with a calibration file and one video per camera"
    terminal.next("posefuse track SESSION --out RESULT", own)
    return figures


@settings_options("options", TrackConfig, {"outputs": "outputs A,B,..."})
def batch(study: Path, /, *, options: BatchOptions, terminal: Shown) -> Figures:
    """Track every session below a folder (participant/trial), with one table.

    A trial that fails is named and the rest is finished. The same command continues where it was interrupted.

    Args:
        study: Folder with the sessions, e.g. STUDY/P01/walk1.
    """
    with terminal.stages() as progress:
        done = pf.batch(study, **arguments_of(pf.batch, options), report=not options.no_report, progress=progress)
    terminal.show(done.summary())
    terminal.next(f"open {done.table} in a spreadsheet", "status and numbers of every trial; each has a report of its own")
    return {"out": done.out, "trials": done.rows(), "kept": done.kept, "failed": dict(done.failed)}
