"""`posefuse demo`, `track` and `batch`: sessions to 3D results."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import ArgumentCollection, Group, Parameter

from posefuse.cli.options import Figures, SettingsOptions, Shown, count, settings_options
from posefuse.pipeline.config import TrackConfig

EXCLUDED = re.compile(r"(?:(?P<camera>.+):)?(?P<start>-?\d+(?:\.\d*)?)-(?P<end>-?\d+(?:\.\d*)?)")
_SHOWN = {
    "rig": "rig FILE", "associate.max_people": "people N", "names": "names A,B,...", "associate.near_xy_m": "person X,Y",
    "start_s": "start S", "end_s": "end S", "body": "body", "refine_rig": "refine-rig", "outputs": "outputs A,B,...",
}  # fmt: skip
_EXPERT = {"input": "input", "fuse.weights": "weights", "raw": "raw", "rate_hz": "rate HZ"}


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
_MAKES = Group("Result", sort_key=-3)


@dataclass(frozen=True, kw_only=True)
class TrackOptions(SettingsOptions):
    """What `posefuse track` reads and makes.

    Attributes:
        out: Folder for the result; must not exist, unless with --force or --resume.
        view: Open the result in the Rerun viewer (extra: viewer).
        exclude: Leave out a camera, or without a name all of them, from second A to B. May be given several times.
        keep_person: Keep only this person.
        no_edits: Ignore earlier marks: leave out nothing, keep all people.
        force: Replace the results in DIR, and start interrupted work from the beginning.
        resume: Continue where the same command was interrupted.
    """

    out: Annotated[Path, Parameter(metavar="DIR", group=_MAKES)]
    view: Annotated[bool, Parameter(group=_MAKES)] = False
    exclude: Annotated[tuple[str, ...], Parameter(metavar="[CAMERA:]A-B", group=_SOLVE_AGAIN, validator=_check_excluded)] = ()
    keep_person: Annotated[int | None, Parameter(metavar="ID", group=_SOLVE_AGAIN, validator=_check_id)] = None
    no_edits: Annotated[bool, Parameter(group=_SOLVE_AGAIN)] = False
    force: Annotated[bool, Parameter(group=_AGAIN)] = False
    resume: Annotated[bool, Parameter(group=_AGAIN)] = False


@settings_options("options", TrackConfig, _EXPERT, show=False)
@settings_options("options", TrackConfig, _SHOWN)
def track(session: Path, /, *, options: TrackOptions, terminal: Shown) -> Figures:
    """Turn a session (calibration + videos, image folders or 2D poses) into a 3D skeleton and write its files.

    Args:
        session: Folder with a calibration file and the recordings; or a result, or the .mcap of `posefuse live --record`, to
            solve again without detecting.
    """
    from posefuse.pipeline.reading import is_live, is_result

    if is_live(session) or is_result(session):
        from posefuse.cli.second_solve import second_solve

        return second_solve(session, options, terminal)
    from posefuse.cli.tracking import track_session

    return track_session(session, options, terminal)


def demo(
    *, out: Annotated[Path, Parameter(metavar="DIR")] = Path("posefuse-demo"), force: bool = False, terminal: Shown
) -> Figures:
    """Track the bundled clip of four cameras: shows within a minute whether everything works.

    Args:
        out: Folder for the result.
        force: Replace DIR if it exists.
    """
    from posefuse.cli.tracking import track_session
    from posefuse.pipeline.demo_clip import clip_folder

    clip = clip_folder()
    terminal.note(f"the clip lies in {clip}; the same as: posefuse track {clip} --out {out}")
    figures = track_session(clip, TrackOptions(out=out, force=force), terminal)
    terminal.next(f"open {out / 'overlay.mp4'}", "all four views with the skeleton drawn in")
    own = "your own recording: a folder with a calibration file and one video per camera"
    terminal.next("posefuse track SESSION --out RESULT", own)
    return figures


@dataclass(frozen=True, kw_only=True)
class BatchOptions(SettingsOptions):
    """What `posefuse batch` makes, and where it runs.

    Attributes:
        out: Folder for the results; run the same command again to continue.
        no_report: Do not write joint angles, gait and the report of each trial.
        jobs: Trials at once (default: as many as the cores and the free memory allow).
        scheduler: Run the trials on this Dask cluster, e.g. tcp://host:8786 (extra: cluster). It must see the same folders.
        force: Run trials again that were completed with other settings or from other files.
    """

    out: Annotated[Path, Parameter(metavar="DIR", group=_MAKES)]
    no_report: Annotated[bool, Parameter(group=_MAKES)] = False
    jobs: Annotated[int | None, Parameter(metavar="N", group=_MAKES), count(1024)] = None
    scheduler: Annotated[str | None, Parameter(metavar="ADDRESS", group=_MAKES)] = None
    force: Annotated[bool, Parameter(group=_MAKES)] = False


@settings_options("options", TrackConfig, {"outputs": "outputs A,B,..."})
def batch(study: Path, /, *, options: BatchOptions, terminal: Shown) -> Figures:
    """Track every session below a folder (participant/trial), with one table and a summary page over participants.

    A trial that fails is named and the rest is finished. The same command continues where it was interrupted.

    Args:
        study: Folder with the sessions, e.g. STUDY/P01/walk1.
    """
    from posefuse.cli.studies import run_batch

    return run_batch(study, options, terminal)
