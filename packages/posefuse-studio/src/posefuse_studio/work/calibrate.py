"""One step of a calibration. A refusal is a result: with its checks, causes and remedies.

Arguments: ``step`` (``intrinsics``, ``extrinsics`` or ``verify``), ``folder`` (of the calibration), ``recording`` (folder with
``videos``), ``target`` (a target file), ``clocks`` (see `calibrate_extrinsics`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.api.calibrate import calibrate_extrinsics, calibrate_intrinsics, observe_target, verify
from posefuse.api.calibration_results import IntrinsicsCalibration, RigCalibration, RigVerification
from posefuse.calibration.extrinsics.world import FloorMarker
from posefuse.calibration.report import CalibrationReport, RefusedCalibration
from posefuse.calibration.targets.kinds import read_target
from posefuse.calibration.targets.recordings import open_sources, require_target_seen
from posefuse.core import InputError
from posefuse_studio.calibrations import LENSES, RIG, Step, rests_on
from posefuse_studio.jobs import read_json_or_empty, write_json
from posefuse_studio.refusal_pictures import refusal_pictures
from posefuse_studio.targets import FLOOR_ID, check_target, without_floor
from posefuse_studio.workspace import StudioWorkspace

CLOCKS = "posefuse.toml"
# rows of boards and cubes need not be looked at 30 times a second
_EVERY = 2


def run(arguments: Mapping[str, Any], workspace: StudioWorkspace, progress: Any) -> dict[str, Any]:
    """Do the step; its result is also kept as ``STEP.json`` in the calibration's folder."""
    steps: Mapping[Step, Callable[..., dict[str, Any]]] = {
        "intrinsics": _intrinsics,
        "extrinsics": _extrinsics,
        "verify": _verify,
    }
    step: Step = arguments["step"]
    if step not in steps:
        raise InputError(f"calibrate: unknown step {step!r}")
    recording = workspace.existing(str(arguments["recording"])) / "videos"
    videos = {path.stem: path for path in sorted(recording.glob("*.mp4"))}
    target = workspace.existing(str(arguments["target"]))
    check_target(read_target(target), step)
    folder = workspace.existing(str(arguments["folder"]))
    made_from = rests_on(folder, step)
    try:
        result = steps[step](workspace, arguments, videos, target, progress)
    except RefusedCalibration as refused:
        result = {"passed": False, "reports": [_report(refused.report)]}
    result = {"step": step, "recording": arguments["recording"], "rests_on": made_from, **result}
    if not result["passed"]:
        result["pictures"] = _pictures(result, videos, target, workspace, arguments)
    write_json(folder / f"{step}.json", result)
    return result


def _pictures(
    result: Mapping[str, Any], videos: Mapping[str, Path], target: Path, workspace: StudioWorkspace, arguments: Mapping[str, Any]
) -> dict[str, str]:
    """By camera, names of images of what was refused."""
    coverage = read_json_or_empty(workspace.existing(str(arguments["recording"])) / "coverage.json")
    folder = workspace.existing(str(arguments["folder"])) / "refused"
    made = refusal_pictures(result, videos, target, folder, coverage)
    return {camera: workspace.name_of(path) for camera, path in made.items()}


def _intrinsics(
    workspace: StudioWorkspace, arguments: Mapping[str, Any], videos: Mapping[str, Any], target: Any, progress: Any
) -> dict[str, Any]:
    found: IntrinsicsCalibration = calibrate_intrinsics(videos, target=target, every=_EVERY, progress=progress)
    folder = workspace.existing(str(arguments["folder"]))
    found.save(folder / LENSES, report=folder / "lenses.html", replace=True)
    return {
        "passed": True,
        "cameras": list(found.rig.names),
        "reports": [_report(one) for one in found.reports.values()],
        "cells": {name: np.asarray(cells).tolist() for name, cells in found.cells.items()},
    }


def _extrinsics(
    workspace: StudioWorkspace, arguments: Mapping[str, Any], videos: Mapping[str, Any], target: Any, progress: Any
) -> dict[str, Any]:
    folder = workspace.existing(str(arguments["folder"]))
    lenses = folder / LENSES
    kind = read_target(target)
    seen = observe_target(videos, target=kind, every=_EVERY, progress=progress)
    require_target_seen(seen.rows(seen.patch != FLOOR_ID), open_sources(videos), without_floor(kind))
    on_floor = len(seen.of_patches([FLOOR_ID])) > 0 and without_floor(kind) != kind
    found: RigCalibration = calibrate_extrinsics(
        seen,
        intrinsics=lenses if lenses.is_file() else None,
        target=kind,
        floor=FloorMarker(FLOOR_ID) if on_floor else None,
        clocks=arguments.get("clocks") or "auto",
        progress=progress,
    )
    found.save(folder / RIG, report=folder / "rig.html", replace=True)
    # those of an earlier calibration hold no longer
    (folder / CLOCKS).write_text(found.clock_settings, encoding="utf-8")
    return {
        "passed": True,
        "cameras": list(found.rig.names),
        "reports": [_report(found.report)],
        "world": "from the marker on the floor" if on_floor else "",
        "clocks": "offsets found" if found.clocks is not None else "synchronised",
        "cells": {name: np.asarray(cells).tolist() for name, cells in found.cells.items()},
        "position_cov_m2": {name: np.asarray(cov).tolist() for name, cov in found.position_cov_m2.items()},
    }


def _verify(
    workspace: StudioWorkspace, arguments: Mapping[str, Any], videos: Mapping[str, Any], target: Any, progress: Any
) -> dict[str, Any]:
    folder = workspace.existing(str(arguments["folder"]))
    found: RigVerification = verify(
        folder / RIG, videos, target=target, every=_EVERY, clock_offset_s=_offsets(folder / CLOCKS), progress=progress
    )
    found.save(folder / "verified.html", replace=True)
    return {"passed": found.passed, "cameras": list(found.rig.names), "reports": [_report(found.report)]}


def _offsets(path: Any) -> dict[str, float]:
    """Clock offsets that the calibration found, by camera name; empty where there are none."""
    from posefuse.pipeline.config import read_config

    cameras = read_config(path).cameras if path.is_file() else {}
    # settings state what is added to stamps, a clock offset how late they are
    return {name: -one.offset_s for name, one in cameras.items()}


def _report(report: CalibrationReport) -> dict[str, Any]:
    return {
        "subject": report.subject,
        "checks": [
            {"name": one.name, "passed": one.passed, "detail": one.detail, "remedy": one.remedy, "kind": one.kind}
            for one in report.checks
        ],
        "notes": list(report.notes),
        "numbers": {name: value for name, value in report.numbers.items() if np.isfinite(value)},
    }
