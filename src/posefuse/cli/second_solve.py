"""`posefuse track LIVE.mcap`: the second solve of a live session, from the observations that it recorded."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.options.shared import SettingsOptions
from posefuse.cli.options.track import TrackOptions
from posefuse.core import InputError, Recording
from posefuse.foundation.compiled import compiling
from posefuse.foundation.output_folder import check_replaceable, output_folder
from posefuse.foundation.places import check_apart
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import DEFAULT_OUTPUTS, TrackConfig, read_config
from posefuse.pipeline.reading import files_of_result, read_result
from posefuse.pipeline.solve import solve_again
from posefuse.pipeline.writing import build_sinks, write_with_frames

from .terminal import Terminal
from .tracking import solve_options

# a recording of a live session holds no images
_NEED_IMAGES = ("overlay",)


def second_solve(path: Path, options: TrackOptions, settings: SettingsOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Solve, write, show; returns the figures of the table. ``exit_code`` is 1 when an output could not be written.

    Raises:
        InputError: an option that is about images, or a recording without a person.
    """
    refused = [
        name for name, value in (("--resume", options.resume), ("--rig", options.rig), ("--input", options.input)) if value
    ]
    if refused:
        raise InputError(f"{refused[0]}: is for sessions of videos, {path} is the recording of a live session")
    clock, inputs = StageClock(), files_of_result(path)
    check_apart(options.out, inputs)
    check_replaceable(options.out, command="track", replace=options.force)
    with clock.stage("read"):
        live = read_result(path, terminal.warn)
    config = _config(options, settings, live)
    sinks = build_sinks(config.outputs)
    with output_folder(
        options.out, command="track", inputs=inputs, replace=options.force, warn=terminal.warn
    ) as out, compiling("tracking", terminal.note):  # fmt: skip
        recording = solve_again(live, config, clock)
        with clock.stage("write"):
            written, failed = write_with_frames(recording, (), sinks, out)
    for name, reason in failed.items():
        terminal.warn(f"output {name}: not written ({reason})")
    figures = {
        "cameras": len(recording.rig),
        "frames": len(live.observations.frame_t_ns),
        "time_steps": len(recording.poses),
        "people": len(recording.poses.person_id),
        "seconds": clock.total_s,
        "out": options.out,
        "files": [path.name for path in written],
        "failed": dict(failed),
        "exit_code": int(bool(failed)),
    }
    terminal.facts(
        "Second solve",
        {
            "live": f"{len(live.poses)} poses, {figures['frames']} frames of {figures['cameras']} cameras",
            "time steps": str(figures["time_steps"]),
            "people": str(figures["people"]),
            "result in": str(options.out),
            "files": ", ".join(path.name for path in written),
        },
    )
    terminal.next(f"posefuse report {options.out}", "joint angles, gait, files for OpenSim and Blender, one page")
    terminal.next(f"posefuse compare {options.out} {path}", "how far the live output was from it")
    if options.view:
        from posefuse.outputs import view_recording

        view_recording(options.out)
    return figures


def _config(options: TrackOptions, settings: SettingsOptions, live: Recording) -> TrackConfig:
    """The session's own settings with the config file and the command line on top."""
    base = dict(live.provenance.get("config") or {})
    base["outputs"] = [name for name in DEFAULT_OUTPUTS if name not in _NEED_IMAGES]
    return read_config(settings.config, settings.overrides, solve_options(options), base)
