"""`posefuse track RESULT` and `posefuse track LIVE.mcap`: solve again from the observations that were kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.cli.command_options import EXCLUDED, TrackOptions
from posefuse.core import InputError, Recording
from posefuse.foundation.compiled import compiling
from posefuse.foundation.output_folder import check_replaceable, output_folder
from posefuse.foundation.places import check_outside_inputs
from posefuse.outputs.rerun_scene import check_viewer
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import DEFAULT_OUTPUTS, TrackConfig, options_by_name, read_config
from posefuse.pipeline.edits import NO_EDITS, Edits, Exclusion, edits_path, read_edits
from posefuse.pipeline.reading import files_of_result, read_result
from posefuse.pipeline.run import refined_line
from posefuse.pipeline.session import Session
from posefuse.pipeline.solve import REFINED, edits_of, solve_again
from posefuse.pipeline.writing import build_sinks, nearby_session, session_frames, write_result

from .terminal import Terminal

_NEED_IMAGES = ("overlay",)


def second_solve(path: Path, options: TrackOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Solve, write, show; returns the figures of the table. ``exit_code`` is 1 when an output could not be written.

    Raises:
        InputError: an option that is about images, edits about what is not there, or a recording without a person.
    """
    given = options.changes
    refused = [
        name for name, value in (("--resume", options.resume), ("--rig", "rig" in given), ("--input", "input" in given)) if value
    ]
    if refused:
        raise InputError(f"{refused[0]}: is for sessions of videos, {path} is a recording of detections")
    if options.view:
        check_viewer()
    clock, inputs = StageClock(), files_of_result(path)
    check_outside_inputs(options.out, inputs)
    check_replaceable(options.out, command="track", replace=options.force)
    with clock.stage("read"):
        earlier = read_result(path, terminal.warn, start_s=given.get("start_s"), end_s=given.get("end_s"))
    session = None if earlier.is_live else nearby_session(earlier, path)
    config = _config(options, earlier, session)
    edits = _edits(path, earlier, options, terminal)
    # an hour of them takes much memory, and only observations are solved again
    earlier = dataclasses.replace(earlier, poses=earlier.poses.people(np.zeros(0, np.intp)))
    sinks = build_sinks(config.outputs, earlier.poses.skeleton)
    with output_folder(
        options.out, command="track", inputs=inputs, replace=options.force, warn=terminal.warn
    ) as out, compiling("tracking", terminal.note):  # fmt: skip
        recording = solve_again(earlier, config, clock, edits)
        if REFINED in recording.provenance:
            terminal.note(refined_line(recording.provenance[REFINED]))
        with clock.stage("write"), terminal.progress("write") as advance:
            frames = () if session is None else session_frames(recording, session, advance)
            written, failed = write_result(recording, frames, sinks, out)
    for name, reason in failed.items():
        terminal.warn(f"output {name}: not written ({reason})")
    figures = {
        "cameras": len(recording.rig),
        "frames": len(earlier.observations.frame_t_ns),
        "time_steps": len(recording.poses),
        "people": len(recording.poses.person_id),
        "exclusions": len(edits.exclusions),
        "seconds": clock.total_s,
        "out": options.out,
        "files": [path.name for path in written],
        "failed": dict(failed),
        "exit_code": int(bool(failed)),
    }
    _show(figures, earlier, terminal)
    terminal.next(f"posefuse report {options.out}", "joint angles, gait, files for OpenSim and Blender, one page")
    terminal.next(f"posefuse compare {options.out} {path}", "how far the earlier result was from it")
    if options.view:
        from posefuse.outputs import view_recording

        view_recording(options.out)
    return figures


def _show(figures: Mapping[str, Any], earlier: Recording, terminal: Terminal) -> None:
    facts = {
        "from": f"{len(earlier.poses)} poses, {figures['frames']} frames of {figures['cameras']} cameras",
        "time steps": str(figures["time_steps"]),
        "people": str(figures["people"]),
        "result in": str(figures["out"]),
        "files": ", ".join(figures["files"]),
    }
    if figures["exclusions"]:
        facts["stretches left out"] = str(figures["exclusions"])
    terminal.facts("Second solve", facts)


def _config(options: TrackOptions, earlier: Recording, session: Session | None) -> TrackConfig:
    """The recording's own settings with the config file and the command line on top."""
    base = dict(earlier.provenance.get("config") or {})
    outputs = options_by_name(DEFAULT_OUTPUTS if earlier.is_live else base.get("outputs") or ())
    base["outputs"] = {name: one for name, one in outputs.items() if session is not None or name not in _NEED_IMAGES}
    return read_config(options.config, options.changes, base)


def _edits(path: Path, earlier: Recording, options: TrackOptions, terminal: Terminal) -> Edits:
    """The edits that the recording was made with, or those kept next to it, with the command line on top."""
    if options.no_edits:
        if options.exclude or options.keep_person is not None:
            raise InputError("--no-edits: expected no --exclude and no --keep-person with it")
        return NO_EDITS
    kept = read_edits(path)
    if kept != NO_EDITS:
        terminal.note(
            f"{edits_path(path)}: what is marked there is left out ({len(kept.exclusions)} stretches); --no-edits uses everything"
        )
    base = kept if kept != NO_EDITS else edits_of(earlier)
    return dataclasses.replace(
        base,
        exclusions=(*base.exclusions, *map(_exclusion, options.exclude)),
        person=base.person if options.keep_person is None else options.keep_person,
    )


def _exclusion(text: str) -> Exclusion:
    found = EXCLUDED.fullmatch(text)
    assert found is not None  # the option checked it
    return Exclusion(camera=found["camera"], start_s=float(found["start"]), end_s=float(found["end"]))
