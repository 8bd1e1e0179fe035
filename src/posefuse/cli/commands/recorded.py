"""`posefuse demo`, `track` and `batch`: sessions to 3D results."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from posefuse.cli.command_options import BatchOptions, TrackOptions
from posefuse.cli.options import Figures, Shown, settings_options
from posefuse.pipeline.config import TrackConfig

_SHOWN = {
    "rig": "rig FILE", "associate.max_people": "people N", "names": "names A,B,...", "associate.near_xy_m": "person X,Y",
    "start_s": "start S", "end_s": "end S", "body": "body", "refine_rig": "refine-rig", "outputs": "outputs A,B,...",
}  # fmt: skip
_EXPERT = {"input": "input", "fuse.weights": "weights", "raw": "raw", "rate_hz": "rate HZ"}


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
    from posefuse.pipeline.session import clip_folder

    clip = clip_folder()
    terminal.note(f"the clip lies in {clip}; the same as: posefuse track {clip} --out {out}")
    figures = track_session(clip, TrackOptions(out=out, force=force), terminal)
    terminal.next(f"open {out / 'overlay.mp4'}", "all four views with the skeleton drawn in")
    own = "your own recording: a folder with a calibration file and one video per camera"
    terminal.next("posefuse track SESSION --out RESULT", own)
    return figures


@settings_options("options", TrackConfig, {"outputs": "outputs A,B,..."})
def batch(study: Path, /, *, options: BatchOptions, terminal: Shown) -> Figures:
    """Track every session below a folder (participant/trial), with one table and a summary page over participants.

    A trial that fails is named and the rest is finished. The same command continues where it was interrupted.

    Args:
        study: Folder with the sessions, e.g. STUDY/P01/walk1.
    """
    from posefuse.cli.studies import run_batch

    return run_batch(study, options, terminal)
