"""What `posefuse live` does around the session: settings, outputs, tables, the report."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.command_options import LiveOptions, OutputOptions, SourceOptions, TimingOptions
from posefuse.cli.options import Ros2Options
from posefuse.core import ConfigError, InputError, LiveOutputConfig, Rig
from posefuse.core.errors import choices
from posefuse.detection.build import DetectorChoice
from posefuse.formats.rig import read_placed_rig, refusal_note
from posefuse.foundation.output_file import check_output_file
from posefuse.foundation.output_folder import check_replaceable
from posefuse.foundation.places import real_path
from posefuse.foundation.plugins import plugin_config
from posefuse.foundation.settings import settings_from_mapping
from posefuse.pipeline.config import read_changed
from posefuse.realtime.capture import LiveInput
from posefuse.realtime.config import LiveConfig, RunOptions
from posefuse.realtime.fusion import Fusion
from posefuse.realtime.inputs import inputs_from_arguments
from posefuse.realtime.messages import SessionClock
from posefuse.realtime.networks import fetch_networks
from posefuse.realtime.outputs import OutputPlan, check_live_outputs
from posefuse.realtime.ros_cameras import rig_with_camera_infos
from posefuse.realtime.session import check_enough, closing_lines, run_live
from posefuse.realtime.video_keeping import read_counts

from .live_report import PAGE_FILE, live_session_figures, show_live_figures, write_latency_report
from .stopping import NO_PERSON_CODE, session_exit_code
from .terminal import Terminal
from .videos import check_videos_folder, kept_videos, video_figures


def run_session(
    rig_file: Path,
    sources: SourceOptions,
    timing: TimingOptions,
    outputs: OutputOptions,
    ros_2: Ros2Options,
    settings: LiveOptions,
    terminal: Terminal,
    *,
    videos: Path | None = None,
) -> Mapping[str, Any]:
    """Run a session; returns the figures of the tables. `videos`: folder that takes the cameras' videos."""
    config = read_changed(settings.config, settings.changes, LiveConfig)
    rig = session_rig(rig_file, terminal)
    if outputs.report:
        check_replaceable(outputs.report, command="live", replace=False)
    if videos:
        _check_videos(videos, outputs.record)
    inputs = settled_inputs(sources, timing, ros_2, rig)
    check_enough(inputs)
    rig = rig_with_camera_infos(rig, inputs, config.camera_info, terminal.note)
    plan = OutputPlan(rig=rig, clock=SessionClock.begin(), configs=output_configs(outputs, ros_2, config))
    check_live_outputs(plan.configs)
    terminal.note(f"{len(inputs)} cameras: " + ", ".join(f"{entry.camera} ({entry.kind})" for entry in inputs))
    fetch_chosen(config.detector, terminal)
    duration_s = run_options(timing).duration_s
    with kept_videos(videos, rig, inputs) as folder:
        done = run_live(rig, inputs, config, plan, duration_s, terminal.note, videos=folder)
        kept = video_figures(read_counts(folder, [entry.camera for entry in inputs])) if folder else {}
        failed = done.outputs_failed or any(one["fault"] for one in kept.values())
        figures = {
            **live_session_figures(done),
            "videos": kept,
            **how_it_ended(done.stopped_by, duration_s, terminal, failed=failed, fusion=done.fusion),
        }
        # before the videos are moved to their place, which a full disk may not allow
        show_live_figures(terminal, figures)
        if outputs.report:
            write_latency_report(outputs.report, done, figures)
    if any(one["written"] for one in kept.values()):
        terminal.next(f"posefuse track {videos} --out DIR", "the videos, solved over all of time")
    _show_next(outputs, terminal, poses=done.fusion.poses)
    return figures


def _check_videos(folder: Path, record: Path | None) -> None:
    """Raise InputError unless the videos of a session can go to `folder`, and its recording not into it."""
    check_videos_folder(folder, command="live")
    if record is not None and real_path(folder) in (real_path(record), *real_path(record).parents):
        raise InputError(f"--record {record}: is, or lies in, the folder of --videos; choose another place for one of them")


def session_rig(rig_file: Path, terminal: Terminal) -> Rig:
    """The rig of a session; warns of one whose calibration was refused."""
    rig = read_placed_rig(rig_file)
    if note := refusal_note(rig_file, rig):
        terminal.warn(note)
    return rig


def fetch_chosen(choice: DetectorChoice, terminal: Terminal) -> None:
    """Download the networks of a session, announced and with a bar; raises ModelError when none can be had."""
    with terminal.stages() as progress:
        fetch_networks(choice, progress)


def how_it_ended(
    stopped_by: str, duration_s: float | None, terminal: Terminal, *, failed: bool = False, fusion: Fusion | None = None
) -> dict[str, int]:
    """Say what request ended the session early, and what its fusion has to report; the exit code, as a figure."""
    code = session_exit_code(stopped_by, endless=duration_s is None, failed=failed)
    if stopped_by and code:
        terminal.note(f"stopped by {stopped_by}" + ("" if duration_s is None else f" before {duration_s:g} s were over"))
    if fusion is not None:
        for line in closing_lines(fusion):
            terminal.warn(line)
        code = code or (0 if fusion.poses_with_people else NO_PERSON_CODE)
    return {"exit_code": code}


def check_nothing_else(*options: Any, videos: Path | None) -> None:
    """Raise ConfigError where a replay is given what only a session with cameras has; nothing is ignored."""
    given = [
        field.name
        for group in options
        for field in dataclasses.fields(group)
        if getattr(group, field.name) != getattr(type(group)(), field.name)
    ]
    if names := [f"--{name.replace('_', '-')}" for name in (*given, *(["videos"] if videos else []))]:
        raise ConfigError(f"--replay feeds a recording to the tracker, without cameras and outputs; leave out {choices(names)}")


def replay_session(rig_file: Path, recording: Path, settings: LiveOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Feed a recording to the tracker again, with its own settings unless others are given; returns the figures."""
    from .replay import replay

    config = read_changed(settings.config, settings.changes, LiveConfig)
    return replay(recording, read_placed_rig(rig_file), config if settings.given else None, terminal)


def _show_next(outputs: OutputOptions, terminal: Terminal, *, poses: int) -> None:
    if outputs.record is None:
        terminal.next("the same with --record FILE.mcap", "keeps views and poses")
    elif poses and outputs.record.exists():
        terminal.next(f"posefuse report {outputs.record}", "joint angles, gait, files for OpenSim and Blender, one page")
        terminal.next(f"posefuse track {outputs.record} --out DIR", "solves it again over all of time, more exactly")
    if outputs.report:
        terminal.next(f"open {outputs.report / PAGE_FILE}", "the latency per camera and stage")


def settled_inputs(sources: SourceOptions, timing: TimingOptions, ros_2: Ros2Options, rig: Rig) -> tuple[LiveInput, ...]:
    """The sources of the command line, and when they begin again."""
    loop_s = run_options(timing).loop_s
    inputs = inputs_from_arguments(sources.source, rig, ros_2.settings)
    return tuple(dataclasses.replace(entry, loop_s=loop_s) for entry in inputs)


def run_options(timing: TimingOptions) -> RunOptions:
    """When it begins and ends."""
    options = {"duration_s": timing.duration, "loop_s": timing.loop}
    return settings_from_mapping(options, RunOptions, where="options")


def output_configs(
    outputs: OutputOptions, ros_2: Ros2Options, config: LiveConfig, also: Mapping[str, Mapping[str, Any]] | None = None
) -> dict[str, LiveOutputConfig]:
    """Configs of the outputs of the settings and the command line by name; `also` adds outputs and options.

    Raises:
        ConfigError: no such output, or options it does not take.
        InputError: a file to record that exists already.
    """
    chosen: dict[str, dict[str, Any]] = {name: dict(options) for name, options in config.outputs.items()}
    for name, options in [*_shorthands(outputs), *(also or {}).items()]:
        chosen[name] = {**chosen.get(name, {}), **options}
    for option, path in (("--record", chosen.get("record", {}).get("path")), ("--view-file", outputs.view_file)):
        if path is not None:
            check_output_file(Path(path), option=option)
    given = {**ros_2.settings, **({"axes": outputs.axes} if outputs.axes else {})}
    return {name: plugin_config("live_outputs", name, options, given=given) for name, options in chosen.items()}


def _shorthands(outputs: OutputOptions) -> Iterator[tuple[str, dict[str, Any]]]:
    """Outputs that options of their own choose, and their options."""
    yield from ((name, {}) for name in outputs.output)
    if outputs.record:
        yield "record", {"path": outputs.record.absolute(), **({"images": True} if outputs.record_images else {})}
    if outputs.ros:
        yield "ros2", {}
    if outputs.ros1:
        yield "ros1", {}
    if outputs.osc:
        yield "osc", {"to": list(outputs.osc)}
    if outputs.json_udp:
        yield "json", {"to": list(outputs.json_udp)}
    if outputs.view_file:
        yield "rerun", {"file": outputs.view_file.absolute()}
    elif outputs.view:
        yield "rerun", {"file": None}
