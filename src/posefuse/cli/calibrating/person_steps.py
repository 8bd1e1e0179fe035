"""The steps without a target: camera poses from a walking person, and clock offsets of calibrated cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from posefuse.api.calibrate import calibrate_clocks, calibrate_person
from posefuse.cli.command_options import ClockOptions, PersonOptions
from posefuse.cli.terminal import Terminal
from posefuse.pipeline.config import CONFIG_FILE

from .inputs import check_files, recordings_of
from .showing import Asked, reported, show_clocks, show_report, write_clocks


def person(inputs: Sequence[str], options: PersonOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Rig file and report from videos, or from 2D poses that another tool has written."""
    outputs = (("--out", options.out), ("--report", options.report))
    check_files((*inputs, options.intrinsics), outputs, force=options.force)
    asked = Asked(step="person", inputs=inputs, options=options)
    with reported(options.report, asked), terminal.stages() as progress:
        found = calibrate_person(
            recordings_of(inputs),
            intrinsics=options.intrinsics,
            height_m=options.height_m,
            camera_distance=options.apart,
            rate_hz=options.rate,
            clocks=options.clocks,
            max_offset_s=options.most_s,
            upside_down=options.upside_down,
            settings=options.changes,
            progress=progress,
        )
    show_report(found.report, terminal)
    found.save(options.out, report=options.report, replace=options.force)
    terminal.next(f"put {options.out} into the folder of your videos: posefuse track SESSION --out RESULT", "the 3D skeleton")
    if found.clocks is not None:
        show_clocks(found.rig.names, found.clocks, found.frame_period_s, terminal)
    settings = write_clocks(options.out.with_name(CONFIG_FILE), found.rig.names, found.clocks, terminal)
    return {"rig": str(options.out), "settings": settings and str(settings), **found.numbers}


def clocks(session: Path, options: ClockOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Clock offset of every camera of a session, written as settings that `posefuse track` of it reads."""
    check_files((options.rig,), (("--report", options.report),), force=options.force)
    chosen = {} if options.input is None else {"input": options.input}
    asked = Asked(step="clocks", inputs=(str(session),), options=options)
    with reported(options.report, asked), terminal.stages() as progress:
        found = calibrate_clocks(
            session,
            rig=options.rig,
            drift=options.clocks == "drift",
            rate_hz=options.rate,
            seconds=options.seconds,
            max_offset_s=options.most_s,
            settings={**chosen, **options.changes},
            progress=progress,
        )
    show_report(found.report, terminal)
    show_clocks(found.rig.names, found.clocks, found.frame_period_s, terminal)
    if options.report is not None:
        found.save_report(options.report, replace=options.force)
    settings = write_clocks(session / CONFIG_FILE, found.rig.names, found.clocks, terminal)
    needed = f"add the offsets to {session / CONFIG_FILE} first" if found.clock_settings else "the clocks need no correction"
    terminal.next(f"posefuse track {session} --out RESULT", "uses the clocks found" if settings else needed)
    return {"settings": settings and str(settings), **found.report.numbers}
