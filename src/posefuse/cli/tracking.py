"""What `posefuse track` does around the pipeline: settings, progress, files, the table at the end."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.command_options import TrackOptions
from posefuse.core import InputError, Recording
from posefuse.detection.build import DetectorChoice, fetch_networks
from posefuse.evaluation.metrics import JointErrors, joint_errors
from posefuse.evaluation.report import CAMERA_COLUMNS, camera_rows
from posefuse.formats.truth import read_truth
from posefuse.foundation.plugins import plugin_config
from posefuse.outputs.rerun_scene import check_viewer
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import CONFIG_FILE, TrackConfig, read_config
from posefuse.pipeline.result_folder import ResultFolder, check_result_folder, track_into
from posefuse.pipeline.run import Tracked
from posefuse.pipeline.session import Session, find_session

from .terminal import Terminal

TRUTH_FILE = Path("truth") / "truth.npz"
_START_UP = ("open", "compile")  # stages that last the same however long the recording


def track_session(folder: Path, options: TrackOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Track a session and write its result; returns the figures of the tables.

    ``exit_code`` among them: 1 when an output could not be written, or cameras do not fit the calibration.
    """
    check_no_edits(options)
    if options.view:
        check_viewer()
    clock = StageClock()
    config = track_config(folder, options)
    session = find_session(folder, config)
    out = ResultFolder(path=options.out, force=options.force, resume=options.resume)
    check_result_folder(session, config, out)
    for note in session.notes:
        terminal.warn(note)
    terminal.note(f"{len(session.inputs)} cameras from {session.rig_path} ({session.inputs[0].kind})")
    with terminal.stages() as report:
        if session.inputs[0].kind != "pose2d":
            fetch_networks(config.detector, report)
        tracked = track_into(session, config, out, clock, report, terminal.warn)
    errors = _errors(session, tracked.recording)
    figures = _figures(options.out, tracked, clock, errors)
    if session.inputs[0].kind != "pose2d":
        figures["network"] = network_shown(config.detector)
    _show(terminal, figures, errors)
    terminal.next(f"posefuse report {options.out}", "joint angles, gait, files for OpenSim and Blender, one page")
    terminal.next(f"posefuse view {options.out}", "the skeleton in the 3D viewer (extra: viewer)")
    if options.view:
        from .viewing import view_result

        view_result(options.out, None if "rerun" in config.outputs else folder, terminal)
    return figures


def check_no_edits(options: TrackOptions) -> None:
    """Raise InputError for options that need a result: what to leave out shows only in one."""
    given = {"--exclude": options.exclude, "--keep-person": options.keep_person is not None, "--no-edits": options.no_edits}
    for name in (name for name, value in given.items() if value):
        raise InputError(f"{name}: is for results; track the session first, then `posefuse track RESULT {name} ... --out DIR`")


def track_config(folder: Path, options: TrackOptions) -> TrackConfig:
    """The config file with the command line's options on top."""
    changes, path = options.changes, options.config or (folder / CONFIG_FILE if (folder / CONFIG_FILE).is_file() else None)
    if "rig" in changes and Path(changes["rig"]).exists():
        changes["rig"] = str(Path(changes["rig"]).absolute())
    return read_config(path, changes)


def network_shown(detector: DetectorChoice) -> str:
    """The network, or its card, by which keypoints were found."""
    config = plugin_config("detectors", detector.name, detector.options)
    return str(next((getattr(config, key) for key in ("card", "landmarks") if hasattr(config, key)), detector.name))


def _errors(session: Session, recording: Recording) -> JointErrors | None:
    path = session.folder / TRUTH_FILE
    return joint_errors(recording.poses, read_truth(path)) if path.is_file() else None


def _figures(out: Path, tracked: Tracked, clock: StageClock, errors: JointErrors | None) -> dict[str, Any]:
    recording = tracked.recording
    time_steps = len(recording.poses)
    images = time_steps * len(recording.rig)
    start_up_s = sum(clock.seconds.get(stage, 0.0) for stage in _START_UP)
    figures: dict[str, Any] = {
        "cameras": len(recording.rig),
        "time_steps": time_steps,
        "people": len(recording.poses.person_id),
        "seconds": clock.total_s,
        "start_up_s": start_up_s,
        "time_steps_per_s": time_steps / (clock.total_s - start_up_s),
        "stage_ms_per_time_step": {
            name: 1000 * seconds / time_steps for name, seconds in clock.seconds.items() if name not in _START_UP
        },
        "stage_share": {name: seconds / clock.total_s for name, seconds in clock.seconds.items()},
        "detect_ms_per_image": 1000 * clock.seconds.get("detect", 0.0) / images,
        "camera_fits": recording.provenance["camera_fits"],
        "rig_warnings": recording.provenance["rig_warnings"],
        "interrupted": tracked.interrupted,
        "failed": dict(tracked.failed),
        "exit_code": int(bool(tracked.failed or recording.provenance["rig_warnings"])),
        "out": out,
        "files": [path.name for path in tracked.files],
    }
    if errors:
        figures["mpjpe_mm"] = errors.mpjpe_mm
        figures["joint_mm"] = {
            joint: {"mean": errors.mean_mm[i], "sd": errors.sd_mm[i], "p95": errors.p95_mm[i], "found": errors.found[i]}
            for i, joint in enumerate(errors.joints)
        }
    return figures


def _show(terminal: Terminal, figures: Mapping[str, Any], errors: JointErrors | None) -> None:
    terminal.table("Cameras", CAMERA_COLUMNS, camera_rows(figures["camera_fits"]))
    facts = {
        "cameras": figures["cameras"],
        "frames": f"{figures['time_steps']} time steps, {figures['time_steps'] * figures['cameras']} images",
        "people": figures["people"],
        **({"network": figures["network"]} if "network" in figures else {}),
    }
    if errors:
        facts["MPJPE against the truth"] = f"{errors.mpjpe_mm:.1f} mm (14 joints)"
        worst = max(range(len(errors.joints)), key=lambda i: errors.mean_mm[i])
        facts["worst joint"] = f"{errors.joints[worst]} {errors.mean_mm[worst]:.1f} mm"
    for stage, ms in figures["stage_ms_per_time_step"].items():
        facts[f"{stage}"] = f"{ms:.1f} ms per time step"
    speed, start_up_s = figures["time_steps_per_s"], figures["start_up_s"]
    facts["speed"] = f"{speed:.1f} time steps/s with everything, after {start_up_s:.0f} s to start"
    facts["result in"] = str(figures["out"])
    facts["files"] = ", ".join(figures["files"])
    terminal.facts("Result", facts)
