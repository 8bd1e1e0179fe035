"""Cameras to videos on one clock: `posefuse.record`; a session for `track` and the calibrations."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from posefuse import core
from posefuse.core import InputError, PosefuseError, Progress, Rig, SourceError
from posefuse.core.errors import warn_caller
from posefuse.formats.kept_video import VIDEOS_FOLDER
from posefuse.formats.rig import write_rig
from posefuse.foundation.output_folder import check_replaceable, find_unfinished, output_folder, read_mark
from posefuse.foundation.summary import Block, Heading, Note, Table
from posefuse.realtime.capture import LiveInput
from posefuse.realtime.inputs import check_any, check_ros_is_used, inputs_from_arguments, shown_again
from posefuse.realtime.session import stop_requests
from posefuse.realtime.video_keeping import KeptCounts, read_counts, write_found_counts
from posefuse.realtime.watching import CameraFeed, Watched, guide

from .arguments import checked, shown
from .rig_and_detector import rig_of

if TYPE_CHECKING:
    from posefuse.calibration.targets.coverage import Guidance

    from .calibrate import TargetLike

RIG_FILE = "rig.toml"
# a camera that is recorded writes more often
_IN_USE_S = 3
_RESUME = "posefuse record --resume --out {}"


def check_videos_folder(folder: Path, *, command: str) -> None:
    """Raise InputError unless videos can go to `folder`: it is free, and no recording of that name waits to be completed."""
    check_replaceable(folder, command=command, replace=False)
    if _interrupted(folder):
        again = _RESUME.format(folder)
        raise InputError(f"{folder}: a recording of this name was interrupted; `{again}` completes it, or choose another name")


def _interrupted(folder: Path) -> list[Path]:
    return [left for left in find_unfinished(folder) if _written(left / VIDEOS_FOLDER)]


def _written(videos: Path) -> list[Path]:
    return [path for path in sorted(videos.glob("*.mp4")) if path.stat().st_size]


@contextmanager
def kept_videos(
    folder: Path | None, rig: Rig | None, inputs: Sequence[LiveInput], *, command: str = "live"
) -> Iterator[Path | None]:
    """Where the videos go while the cameras run; complete in `folder` after it, with the rig. None: none are kept.

    A session that is killed leaves what was written in the staging folder next to it, see `resume_recording`.

    Raises:
        InputError: `folder` cannot be used, or cannot be completed; the message names where the videos are.
    """
    if folder is None:
        yield None
        return
    with output_folder(folder, command=command, keep_unfinished=True) as out:
        if rig is not None:
            write_rig(out.folder / RIG_FILE, rig.only(entry.camera for entry in inputs))
        videos = out.folder / VIDEOS_FOLDER
        videos.mkdir()
        try:
            yield videos
        except BaseException as error:
            if not _written(videos):
                shutil.rmtree(videos)
                (out.folder / RIG_FILE).unlink(missing_ok=True)
            elif isinstance(error, PosefuseError):
                error.add_note(f"what was recorded until then is kept; `{_RESUME.format(folder)}` completes it")
            raise


def _check_recorded(videos: Path, counts: Mapping[str, KeptCounts], stopped: Sequence[str] = ()) -> None:
    """Where no camera delivered a frame raise SourceError, or KeyboardInterrupt after a request to stop."""
    if any(one.written or not (videos / f"{name}.json").is_file() for name, one in counts.items()):
        return
    if stopped:
        raise KeyboardInterrupt
    raise SourceError(f"no frame came from {', '.join(counts)}: nothing was recorded; are the cameras switched on?")


_SAY_EVERY = 5


@dataclass(frozen=True, kw_only=True)
class RecordedVideos:
    """Videos that were recorded, and what of a target the cameras saw.

    Attributes:
        folder: the session; None where nothing was kept. videos: figures by camera.
        guidance: what of the target was covered; None without one. stopped_by: name of the signal that ended it; empty: none.
    """

    folder: Path | None
    videos: Mapping[str, Mapping[str, Any]]
    guidance: Guidance | None = None
    stopped_by: str = ""

    @property
    def lost(self) -> bool:
        """Whether a frame of any camera is missing."""
        return any(one["fault"] or one["dropped"] for one in self.videos.values())

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values."""
        found: dict[str, Any] = {"videos": dict(self.videos)} if self.folder is not None else {}
        if self.guidance is None:
            return {"session": str(self.folder), **found}
        seen = self.guidance.coverage
        covered = zip(seen.cameras, seen.share.tolist(), strict=True)
        return {"enough": seen.enough, "covered": dict(covered), "next": seen.advice(), **found}

    def summary(self) -> list[Block]:
        """A table, and a warning of each camera that lost frames."""
        if not self.videos:
            return []
        rows = [(name, one["written"], one["rate_hz"], one["dropped"], one["longest_gap_s"] * 1e3, one["how"])
                for name, one in self.videos.items()]  # fmt: skip
        faults = [f"{name}: {one['fault']}" for name, one in self.videos.items() if one["fault"]]
        missing = [
            f"{name}: {frames} frames are missing: {cause}"
            for name, one in self.videos.items()
            for cause, frames in one["lost"].items()
        ]
        columns = ("camera", "frames", "frames/s", "dropped", "longest gap, ms", "kept as")
        return [Heading("videos"), Table(columns, rows), *(Note(line, warning=True) for line in (*faults, *missing))]


@checked
def record(
    sources: Mapping[str, str] | Sequence[str],
    out: str | Path | None = None,
    *,
    rig: core.Rig | str | Path | None = None,
    target: TargetLike | None = None,
    duration_s: float | None = None,
    ros: Mapping[str, Any] | None = None,
    on_coverage: Callable[[Guidance], None] | None = None,
    progress: Progress | bool | None = None,
) -> RecordedVideos:
    """Record cameras: one video per camera on one clock; with a target, until the cameras have seen enough of it.

    Ctrl-C ends it, and what was recorded is complete. What is wrong with a camera is a `UserWarning`.

    Args:
        sources: as for `live`. out: new session folder; None, with `target` only: nothing is kept.
        rig: gives the cameras' names; without `target` it becomes part of the session, and frames must have its sizes.
        target: what is moved in front of the cameras: a target, or its file.
        duration_s: stop so many seconds after the first frame of the last camera.
        ros: as for `live`. on_coverage: is called once a second with what of the target is covered.
        progress: True for lines on stderr, or a function (see `Progress`).

    Raises:
        SourceError: no source, one that fails, or none that delivers a frame. InputError: `out` cannot be used.
        CalibrationError: a chessboard, whose corners cameras count from different ends.

    Examples:
        >>> import posefuse as pf
        >>> pf.record({"cam1": "usb:0", "cam2": "usb:1"}, "SESSION", duration_s=10).videos  # doctest: +SKIP
    """
    from posefuse.calibration.targets.kinds import check_one_end

    from .calibrate import target_of

    if out is None and target is None:
        raise InputError("record: expected a folder `out` for the videos, or a target to look at")
    folder, kind = None if out is None else Path(out), None if target is None else target_of(target)
    if kind is not None:
        check_one_end(kind)
    cameras = None if rig is None else rig_of(rig)
    inputs = inputs_from_arguments(sources, cameras, ros)
    check_any(inputs)
    check_ros_is_used(ros or {}, inputs, {})
    if folder is not None:
        check_videos_folder(folder, command="record")
    names, placed = [entry.camera for entry in inputs], cameras if kind is None else None
    with (
        shown(progress) as report,
        stop_requests() as stopped,
        CameraFeed(inputs, rig=placed, packets=folder is not None, target=kind) as feed,
        kept_videos(folder, placed, inputs, command="record") as videos,
    ):
        found = None
        if kind is not None:
            found = guide(feed, on_coverage or (lambda _: None), duration_s, videos=videos, stopped=stopped)
        elif videos is not None:
            end = "Ctrl-C ends" if duration_s is None else f"{duration_s:g} s"
            report("record", 0, None, f"recording {', '.join(names)}; {end}")
            _report_news(feed.watched(videos, duration_s, stopped, judged=True), report)
        counts = feed.counts()
        if videos is not None:
            _check_recorded(videos, counts, stopped)
    return RecordedVideos(folder=folder, videos=video_figures(counts), guidance=found, stopped_by=stopped[0] if stopped else "")


def watch(
    sources: Mapping[str, str] | Sequence[str],
    *,
    target: TargetLike | None = None,
    keep: bool = False,
    loop_s: float | Literal["shortest"] | None = None,
) -> CameraFeed:
    """Cameras to look at without tracking: open in a `with` block, in which `CameraFeed.watched` gives their newest frames.

    Args:
        sources, loop_s: as for `live`. target: what is moved in front of the cameras. keep: whether videos are to be kept.

    Raises:
        SourceError: no source, or one that cannot be read. ConfigError: a target file that cannot be used.

    Examples:
        >>> from posefuse.api.record import watch
        >>> with watch({"cam1": "usb:0"}) as cameras:  # doctest: +SKIP
        ...     for frames, news in cameras.watched(judged=True):
        ...         print([one.warning for one in news])
    """
    from .calibrate import target_of

    inputs = shown_again(inputs_from_arguments(sources, None), loop_s)
    # packets of files come in any encoding, and again from the start where a video begins again: they are encoded again
    packets = keep and all(entry.kind != "video" for entry in inputs)
    return CameraFeed(inputs, packets=packets, target=None if target is None else target_of(target))


def resume_recording(folder: str | Path) -> RecordedVideos:
    """Complete the videos of a program that was killed while it recorded to `folder`; no cameras are opened.

    Raises:
        InputError: there are none, they are still being written, or they cannot be moved to `folder`.

    Examples:
        >>> import posefuse as pf
        >>> pf.resume_recording("SESSION").videos  # doctest: +SKIP
    """
    place = Path(folder)
    left = _interrupted(place)
    if not left:
        raise InputError(f"{place}: no recording of this name was interrupted; nothing to resume")
    staging = left[-1]
    videos, mark = staging / VIDEOS_FOLDER, read_mark(staging)
    assert mark is not None
    made = _written(videos)
    if any(abs(time.time() - path.stat().st_mtime) < _IN_USE_S for path in made):
        raise InputError(f"{place}: {staging} was written to within the last {_IN_USE_S} s; is it still being recorded?")
    with output_folder(place, command=mark.command, keep_unfinished=True, unfinished=staging):
        for path in made:
            write_found_counts(path)
        counts = read_counts(videos, [path.stem for path in made])
    return RecordedVideos(folder=place, videos=video_figures(counts))


def _report_news(watch: Watched, report: Progress) -> None:
    """Report the rates now and then, and every warning once, until it ends."""
    known: set[tuple[str, str]] = set()
    begin_s = time.monotonic()
    for _, news in watch:
        for one in news:
            # without its numbers, which change every second
            kind = "".join("#" if c.isdigit() else c for c in one.warning)
            if one.warning and (one.camera, kind) not in known:
                known.add((one.camera, kind))
                warn_caller(f"{one.camera}: {one.warning}")
        seconds = time.monotonic() - begin_s
        if news and round(seconds) % _SAY_EVERY == 0:
            rates = ", ".join(
                f"{one.camera} {one.rate_hz:.1f}" + (f" ({one.missing} lost)" if one.missing else "") for one in news
            )
            report("record", 0, None, f"{seconds:.0f} s, frames/s: {rates}")


def video_figures(counts: Mapping[str, KeptCounts]) -> dict[str, Any]:
    """Frames written and lost, rate and longest gap, by camera."""
    return {name: {**asdict(one), "dropped": one.dropped, "rate_hz": one.rate_hz} for name, one in counts.items()}
