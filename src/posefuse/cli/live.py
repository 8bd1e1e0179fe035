"""What `posefuse live` does around the session: settings, outputs, tables, the report."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.core import ConfigError, InputError, Rig
from posefuse.formats.rig import read_placed_rig
from posefuse.pipeline.config import read_overridden
from posefuse.realtime.capture import LiveInput
from posefuse.realtime.clock import SessionClock
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.faults import faults_from_arguments
from posefuse.realtime.inputs import inputs_from_arguments
from posefuse.realtime.outputs import OutputPlan
from posefuse.realtime.session import run_live

from .live_report import figures_of, show, write_report
from .terminal import Terminal


def live(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Run a session, or replay one; returns the figures of the tables."""
    config = settled_config(args)
    rig = read_placed_rig(args.rig)
    if args.replay:
        from .replay import replay

        told = args.config or args.overrides or args.tracker or args.people
        return replay(args.replay, rig, config if told else None, terminal)
    if args.report and args.report.exists() and any(args.report.iterdir()):
        raise InputError(f"{args.report}: is there already and not empty; choose another folder")
    inputs = settled_inputs(args, rig)
    terminal.note(f"{len(inputs)} cameras: " + ", ".join(f"{entry.camera} ({entry.kind})" for entry in inputs))
    done = run_live(rig, inputs, config, output_plan(args, rig), args.duration, terminal.note)
    figures = figures_of(done)
    show(terminal, figures)
    if args.report:
        write_report(args.report, done, figures)
    return figures


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
        from posefuse.messages.dds import Network

        network = Network(args.domain, args.local_only, args.interface, tuple(args.peer))
    if args.record is not None and args.record.exists():
        raise InputError(f"{args.record}: is there already; choose another name or move it away")
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
