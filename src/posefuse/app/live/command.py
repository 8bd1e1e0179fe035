"""What `posefuse live` does around the session: settings, outputs, tables, the report."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.app.config import read_overridden
from posefuse.app.detectors import fetch_networks
from posefuse.app.terminal import Terminal
from posefuse.core import ConfigError, Rig
from posefuse.files.output_file import check_output_file
from posefuse.files.output_folder import check_replaceable
from posefuse.files.rig import read_rig

from .capture import LiveInput
from .clock import SessionClock
from .config import LiveConfig
from .faults import faults_from_arguments
from .inputs import inputs_from_arguments
from .outputs import OutputPlan
from .report import figures_of, show, write_report
from .session import run_live


def live(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Run a session, or replay one; returns the figures of the tables."""
    config = settled_config(args)
    rig = read_rig(args.rig)
    if args.replay:
        from .replay import replay

        told = args.config or args.overrides or args.tracker or args.people
        return replay(args.replay, rig, config if told else None, terminal)
    if args.report:
        check_replaceable(args.report, command="live", replace=False)
    inputs = settled_inputs(args, rig)
    terminal.note(f"{len(inputs)} cameras: " + ", ".join(f"{entry.camera} ({entry.kind})" for entry in inputs))
    fetch_networks(config.detector, terminal)
    done = run_live(rig, inputs, config, output_plan(args, rig), args.duration, terminal.note)
    figures = figures_of(done)
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
    if args.report:
        terminal.next(f"open {args.report / 'report.html'}", "where the time went, per camera and stage")


def settled_inputs(args: argparse.Namespace, rig: Rig) -> tuple[LiveInput, ...]:
    """The sources of the command line, with what is to go wrong with them and when they begin again."""
    if args.loop is not None and args.loop <= 0:
        raise ConfigError(f"--loop: expected more than 0 s, got {args.loop:g}")
    faults = faults_from_arguments(args.fault, rig)
    return tuple(
        dataclasses.replace(
            entry, faults=faults.get(entry.camera, ()), reopen=entry.reopen or entry.camera in faults, loop_s=args.loop
        )
        for entry in inputs_from_arguments(args.source, rig, args.domain)
    )


def settled_config(args: argparse.Namespace) -> LiveConfig:
    """The config file with the command line's options on top."""
    config: LiveConfig = read_overridden(args.config, args.overrides, LiveConfig)
    track = config.track
    if args.tracker:
        track = dataclasses.replace(track, tracker=args.tracker)
    if args.people:
        track = dataclasses.replace(track, max_people=args.people)
    changes = {"rate_hz": args.rate, "groups": args.groups}
    return dataclasses.replace(config, track=track, **{key: value for key, value in changes.items() if value is not None})


def output_plan(args: argparse.Namespace, rig: Rig) -> OutputPlan:
    """Where the command line sends results."""
    network = None
    if args.ros:
        from posefuse.wire.dds import Network

        network = Network(args.domain, args.local_only, args.interface, tuple(args.peer))
    for option, path in (("--record", args.record), ("--view-file", args.view_file)):
        if path is not None:
            check_output_file(path, option=option)
    view = str(args.view_file) if args.view_file else "spawn" if args.view else ""
    return OutputPlan(
        rig,
        SessionClock.begin(),
        record=_absolute(args.record),
        osc=tuple(args.osc),
        json_udp=tuple(args.json_udp),
        axes=args.axes,
        ros=network,
        view=view,
    )


def _absolute(path: Path | None) -> Path | None:
    return None if path is None else path.absolute()
