"""What `posefuse live` does around the session: settings, outputs, tables, the report."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.networks import fetch_networks
from posefuse.core import LiveOutputConfig, Rig
from posefuse.formats.rig import read_placed_rig
from posefuse.foundation.output_file import check_output_file
from posefuse.foundation.output_folder import check_replaceable
from posefuse.foundation.plugins import plugin_config
from posefuse.foundation.settings import settings_from_mapping
from posefuse.pipeline.config import read_overridden
from posefuse.realtime.capture import LiveInput
from posefuse.realtime.clock import SessionClock
from posefuse.realtime.config import LiveConfig, RunOptions
from posefuse.realtime.faults import faults_from_arguments
from posefuse.realtime.inputs import inputs_from_arguments
from posefuse.realtime.output_plan import OutputPlan
from posefuse.realtime.session import run_live

from .live_report import figures_of, show, write_report
from .terminal import Terminal
from .videos import kept_videos, video_figures


def live(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Run a session, or replay one; returns the figures of the tables."""
    config = settled_config(args)
    rig = read_placed_rig(args.rig)
    if args.replay:
        from .replay import replay

        told = args.config or args.overrides or args.tracker or args.people is not None
        return replay(args.replay, rig, config if told else None, terminal)
    if args.report:
        check_replaceable(args.report, command="live", replace=False)
    inputs = settled_inputs(args, rig)
    plan = OutputPlan(rig=rig, clock=SessionClock.begin(), configs=output_configs(args, config))
    terminal.note(f"{len(inputs)} cameras: " + ", ".join(f"{entry.camera} ({entry.kind})" for entry in inputs))
    fetch_networks(config.detector, terminal)
    if args.videos:
        check_replaceable(args.videos, command="live", replace=False)
    with kept_videos(args.videos, rig, inputs) as videos:
        done = run_live(rig, inputs, config, plan, run_options(args).duration_s, terminal.note, videos)
    figures = figures_of(done)
    if args.videos:
        figures["videos"] = video_figures(args.videos, inputs)
    show(terminal, figures)
    if args.report:
        write_report(args.report, done, figures)
    _show_next(args, terminal)
    return figures


def _show_next(args: argparse.Namespace, terminal: Terminal) -> None:
    if args.record:
        terminal.next(
            f"posefuse live {args.rig} --replay {args.record}", "the recording once more, with other settings if you like"
        )
    else:
        terminal.next("the same with --record FILE.mcap", "keeps views and poses")
    if args.videos:
        terminal.next(f"posefuse track {args.videos} --out DIR", "the videos, solved over all of time")
    if args.report:
        terminal.next(f"open {args.report / 'report.html'}", "where the time went, per camera and stage")


def settled_inputs(args: argparse.Namespace, rig: Rig) -> tuple[LiveInput, ...]:
    """The sources of the command line, with what is to go wrong with them and when they begin again."""
    run, faults = run_options(args), faults_from_arguments(args.fault, rig)
    return tuple(
        dataclasses.replace(
            entry, faults=faults.get(entry.camera, ()), reopen=entry.reopen or entry.camera in faults, loop_s=run.loop_s
        )
        for entry in inputs_from_arguments(args.source, rig, args.domain)
    )


def settled_config(args: argparse.Namespace) -> LiveConfig:
    """The config file with the command line's options on top, all of it validated alike."""
    options = {
        "--rate": ("rate_hz", args.rate),
        "--groups": ("groups", args.groups),
        "--tracker": ("track.tracker", args.tracker),
        "--people": ("track.max_people", args.people),
    }
    return read_overridden(args.config, args.overrides, LiveConfig, options)


def run_options(args: argparse.Namespace) -> RunOptions:
    """When it begins and ends."""
    options = {"duration_s": args.duration, "loop_s": args.loop, "zero_s": getattr(args, "zero", None)}
    return settings_from_mapping(options, RunOptions, where="options")


def output_configs(
    args: argparse.Namespace, config: LiveConfig, also: Mapping[str, Mapping[str, Any]] | None = None
) -> dict[str, LiveOutputConfig]:
    """Configs of the outputs of the settings and the command line by name; `also` adds outputs and options.

    Raises:
        ConfigError: no such output, or options it does not take.
        InputError: a file to record that exists already.
    """
    chosen: dict[str, dict[str, Any]] = {name: dict(options) for name, options in config.outputs.items()}
    shorthands = {
        "record": args.record and {"path": args.record.absolute()},
        "ros2": args.ros and {},
        "osc": args.osc and {"to": args.osc},
        "json": args.json_udp and {"to": args.json_udp},
        "rerun": {"file": args.view_file.absolute()} if args.view_file else args.view and {},
    }
    named = {name: options for name, options in shorthands.items() if isinstance(options, dict)}
    for name, options in [*((name, {}) for name in args.output), *named.items(), *(also or {}).items()]:
        chosen[name] = {**chosen.get(name, {}), **options}
    for option, path in (("--record", chosen.get("record", {}).get("path")), ("--view-file", args.view_file)):
        if path is not None:
            check_output_file(Path(path), option=option)
    known = {
        "domain_id": args.domain, "local_only": args.local_only, "interface": args.interface, "peers": args.peer,
        "axes": args.axes,
    }  # fmt: skip
    return {name: plugin_config("live_outputs", name, options, known) for name, options in chosen.items()}
