"""What `posefuse record` does: videos on one clock, warnings while problems can still be fixed, and the next step."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from posefuse.cli.command_options import RecordOptions
from posefuse.cli.options import Ros2Options
from posefuse.core import SourceError
from posefuse.formats.rig import read_rig
from posefuse.realtime.inputs import inputs_from_arguments
from posefuse.realtime.session import stop_requests
from posefuse.realtime.video_keeping import read_counts
from posefuse.realtime.watching import CameraFeed, CameraNews, record

from .stopping import session_exit_code
from .terminal import Terminal
from .videos import check_recorded, check_videos_folder, completed_recording, kept_videos, video_figures

_SAY_EVERY = 5


def record_session(options: RecordOptions, ros_2: Ros2Options, terminal: Terminal) -> Mapping[str, Any]:
    """Record until the time is over, the sources end, or Ctrl-C; returns frames, losses and rates by camera."""
    if options.resume:
        figures = video_figures(completed_recording(options.out))
        show_videos(figures, terminal)
        return {"session": str(options.out), "videos": figures, "exit_code": 0}
    rig = None if options.rig is None else read_rig(options.rig)
    inputs = inputs_from_arguments(options.source, rig, ros_2.settings)
    if not inputs:
        raise SourceError("expected a source for at least 1 camera, got none; see --source")
    check_videos_folder(options.out, command="record")
    names = [entry.camera for entry in inputs]
    with (
        stop_requests() as stopped,
        CameraFeed(inputs, rig=rig, packets=True) as feed,
        kept_videos(options.out, rig, inputs, command="record") as videos,
    ):
        assert videos is not None
        terminal.note(
            f"recording {', '.join(names)}; " + ("Ctrl-C ends" if options.duration is None else f"{options.duration:g} s")
        )
        record(feed, videos, _reporter(terminal), duration_s=options.duration, stopped=stopped)
        figures = checked_figures(videos, names, stopped, terminal)
    _show_next(options.out, options.rig, terminal)
    by = stopped[0] if stopped else ""
    return {
        "session": str(options.out),
        "videos": figures,
        "exit_code": session_exit_code(by, endless=options.duration is None, failed=any_lost(figures)),
    }


def checked_figures(videos: Path, cameras: Sequence[str], stopped: Sequence[str], terminal: Terminal) -> dict[str, Any]:
    """What was recorded, shown; raises SourceError where that is nothing."""
    counts = read_counts(videos, cameras)
    check_recorded(videos, counts, stopped)
    figures = video_figures(counts)
    show_videos(figures, terminal)
    return figures


def any_lost(figures: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether a frame of any camera is missing."""
    return any(one["fault"] or one["dropped"] for one in figures.values())


def _reporter(terminal: Terminal) -> Callable[[float, tuple[CameraNews, ...]], None]:
    """Say the rates now and then, and every warning once."""
    said: set[tuple[str, str]] = set()

    def report(seconds: float, news: tuple[CameraNews, ...]) -> None:
        for one in news:
            kind = one.warning.split(":")[0].split(" frames/s")[-1]
            if one.warning and (one.camera, kind) not in said:
                said.add((one.camera, kind))
                terminal.warn(f"{one.camera}: {one.warning}")
        if round(seconds) % _SAY_EVERY == 0:
            rates = ", ".join(
                f"{one.camera} {one.rate_hz:.1f}" + (f" ({one.missing} lost)" if one.missing else "") for one in news
            )
            terminal.note(f"{seconds:.0f} s, frames/s: {rates}")

    return report


def show_videos(figures: Mapping[str, Mapping[str, Any]], terminal: Terminal) -> None:
    """A table, and a warning of each camera that lost frames."""
    rows = [(name, one["written"], one["rate_hz"], one["dropped"], one["longest_gap_s"] * 1e3, one["how"])
            for name, one in figures.items()]  # fmt: skip
    terminal.table("videos", ("camera", "frames", "frames/s", "dropped", "longest gap, ms", "kept as"), rows)
    for name, one in figures.items():
        if one["fault"]:
            terminal.warn(f"{name}: {one['fault']}")
        for cause, frames in one["lost"].items():
            terminal.warn(f"{name}: {frames} frames are missing: {cause}")


def _show_next(session: Path, rig: Path | None, terminal: Terminal) -> None:
    if rig is None:
        command = f"posefuse calibrate intrinsics --target TARGET.toml --out lenses.toml {session}"
        terminal.next(command, "the intrinsics, from a board; or `calibrate extrinsics` with --intrinsics, from a moved target")
    else:
        terminal.next(f"posefuse track {session} --out RESULT", "the 3D skeleton")
