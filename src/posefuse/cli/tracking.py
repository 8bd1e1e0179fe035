"""What `posefuse track` does around the pipeline: settings, progress, files, the table at the end."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.core import InputError, Recording
from posefuse.evaluation.metrics import JointErrors, joint_errors
from posefuse.formats.truth import read_truth
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import CONFIG_FILE, TrackConfig, read_config
from posefuse.pipeline.run import Tracked, track_session
from posefuse.pipeline.session import Session, find_session
from posefuse.pipeline.writing import build_sinks, write_result

from .terminal import Terminal

TRUTH_FILE = Path("truth") / "truth.npz"
_START_UP = ("open", "compile")  # stages that last the same however long the recording


def track(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Track a session and write its result; returns the figures of the tables."""
    clock = StageClock()
    config = settled_config(args)
    if args.out.exists() and not args.force:
        raise InputError(f"{args.out}: is there already; choose another folder or add --force to replace it")
    sinks = build_sinks(config.outputs)
    session = find_session(args.session, config)
    for note in session.notes:
        terminal.warn(note)
    terminal.note(f"{len(session.inputs)} cameras from {session.rig_path} ({session.inputs[0].kind})")
    with terminal.progress("tracking") as advance:
        tracked = track_session(session, config, clock, advance, terminal.note, terminal.warn)
    if tracked.interrupted:
        terminal.warn(f"stopped by Ctrl-C; the first {len(tracked.recording.poses)} instants are finished and kept")
    with clock.stage("write"), terminal.progress("writing") as advance:
        written = write_result(tracked.recording, session, config, sinks, args.out, advance)
    errors = _errors(session, tracked.recording)
    figures = _figures(args.out, tracked, clock, written, errors)
    _show(terminal, figures, errors)
    if args.view:
        from posefuse.outputs import view_recording

        view_recording(args.out)
    return figures


def settled_config(args: argparse.Namespace) -> TrackConfig:
    """The config file with the command line's options on top."""
    path = args.config or (args.session / CONFIG_FILE if (args.session / CONFIG_FILE).is_file() else None)
    config = read_config(path, args.overrides)
    changes: dict[str, Any] = {}
    for option, key in (("rig", "rig"), ("input", "input"), ("start", "start_s"), ("end", "end_s")):
        if getattr(args, option) is not None:
            changes[key] = (
                str(Path(args.rig).absolute()) if option == "rig" and Path(args.rig).exists() else getattr(args, option)
            )
    if args.raw:
        changes["raw"] = True
    if args.weights:
        changes["fuse"] = dataclasses.replace(config.fuse, weights=args.weights)
    if args.person:
        changes["associate"] = dataclasses.replace(config.associate, near_xy_m=args.person)
    if args.outputs is not None:
        changes["outputs"] = tuple(name for name in args.outputs.split(",") if name)
    return dataclasses.replace(config, **changes)


def _errors(session: Session, recording: Recording) -> JointErrors | None:
    path = session.folder / TRUTH_FILE
    return joint_errors(recording.poses, read_truth(path)) if path.is_file() else None


def _figures(out: Path, tracked: Tracked, clock: StageClock, written: list[Path], errors: JointErrors | None) -> dict[str, Any]:
    recording = tracked.recording
    instants = len(recording.poses)
    images = instants * len(recording.rig)
    start_up_s = sum(clock.seconds.get(stage, 0.0) for stage in _START_UP)
    figures: dict[str, Any] = {
        "cameras": len(recording.rig),
        "instants": instants,
        "people": len(recording.poses.person_id),
        "seconds": clock.total_s,
        "start_up_s": start_up_s,
        "instants_per_s": instants / (clock.total_s - start_up_s),
        "stage_ms_per_instant": {
            name: 1000 * seconds / instants for name, seconds in clock.seconds.items() if name not in _START_UP
        },
        "stage_share": {name: seconds / clock.total_s for name, seconds in clock.seconds.items()},
        "detect_ms_per_image": 1000 * clock.seconds.get("detect", 0.0) / images,
        "found": dict(tracked.found),
        "interrupted": tracked.interrupted,
        "out": out,
        "files": [path.name for path in written],
    }
    if errors:
        figures["mpjpe_mm"] = errors.mpjpe_mm
        figures["joint_mm"] = {
            joint: {"mean": errors.mean_mm[i], "sd": errors.sd_mm[i], "p95": errors.p95_mm[i], "found": errors.found[i]}
            for i, joint in enumerate(errors.joints)
        }
    return figures


def _show(terminal: Terminal, figures: Mapping[str, Any], errors: JointErrors | None) -> None:
    facts = {
        "cameras": figures["cameras"],
        "frames": f"{figures['instants']} instants, {figures['instants'] * figures['cameras']} images",
        "people": figures["people"],
        "seen in": ", ".join(f"{name} {share:.0%}" for name, share in figures["found"].items()),
    }
    if errors:
        facts["MPJPE against the truth"] = f"{errors.mpjpe_mm:.1f} mm (14 joints)"
        worst = max(range(len(errors.joints)), key=lambda i: errors.mean_mm[i])
        facts["worst joint"] = f"{errors.joints[worst]} {errors.mean_mm[worst]:.1f} mm"
    for stage, ms in figures["stage_ms_per_instant"].items():
        facts[f"{stage}"] = f"{ms:.1f} ms per instant"
    facts["speed"] = f"{figures['instants_per_s']:.1f} instants/s with everything, after {figures['start_up_s']:.0f} s to start"
    facts["result in"] = str(figures["out"])
    facts["files"] = ", ".join(figures["files"])
    terminal.facts("Result", facts)
