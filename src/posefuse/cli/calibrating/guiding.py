"""`posefuse calibrate guide`: a table and the next step once a second."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from posefuse.calibration.targets.coverage import Guidance
from posefuse.calibration.targets.kinds import read_target
from posefuse.cli.command_options import GuideOptions
from posefuse.cli.options import Ros2Options
from posefuse.cli.recording import any_lost, checked_figures
from posefuse.cli.stopping import session_exit_code
from posefuse.cli.terminal import Terminal
from posefuse.cli.videos import check_videos_folder, kept_videos
from posefuse.formats.rig import read_rig
from posefuse.realtime.inputs import inputs_from_arguments
from posefuse.realtime.session import stop_requests
from posefuse.realtime.watching import CameraFeed, guide


def guide_at_cameras(options: GuideOptions, ros_2: Ros2Options, terminal: Terminal) -> Mapping[str, Any]:
    """Show what is covered until it is enough; returns the coverage."""

    def report(state: Guidance) -> None:
        covered = state.coverage
        rows = [(name, f"{share:.0%}", *counts) for name, share, counts in
                zip(covered.cameras, covered.share, covered.together.tolist(), strict=True)]  # fmt: skip
        terminal.table("seen together with", ("camera", "covered", *covered.cameras), rows)
        terminal.note(state.words)

    if options.record is not None:
        check_videos_folder(options.record, command="record")
    kind = read_target(options.target)
    rig = None if options.intrinsics is None else read_rig(options.intrinsics)
    inputs = inputs_from_arguments(options.source, rig, ros_2.settings)
    with (
        stop_requests() as stopped,
        CameraFeed(inputs, packets=options.record is not None) as feed,
        kept_videos(options.record, None, inputs, command="record") as videos,
    ):
        found = guide(feed, kind, report, options.duration, videos=videos, stopped=stopped)
        figures = _figures(found)
        if videos is not None:
            figures["videos"] = checked_figures(videos, [one.camera for one in inputs], stopped, terminal)
    _show_next(options, found, terminal)
    by, failed = stopped[0] if stopped else "", any_lost(figures.get("videos", {}))
    return {**figures, "exit_code": session_exit_code(by, endless=options.duration is None, failed=failed)}


def _figures(found: Guidance) -> dict[str, Any]:
    covered = {name: float(share) for name, share in zip(found.coverage.cameras, found.coverage.share, strict=True)}
    return {"enough": found.enough, "covered": covered, "next": found.words}


def _show_next(options: GuideOptions, found: Guidance, terminal: Terminal) -> None:
    if not found.enough:
        terminal.note(f"not enough yet: {found.words}")
    where = options.record or "SESSION"
    lenses = "" if options.intrinsics is None else f" --intrinsics {options.intrinsics}"
    terminal.next(
        f"posefuse calibrate extrinsics {where} --target {options.target}{lenses} --out rig.toml",
        "the rig from what was recorded",
    )
