"""One step of a calibration. A refusal is a result: with its checks, causes and remedies.

Arguments: ``step`` (``intrinsics``, ``extrinsics`` or ``verify``), ``folder`` (of the calibration), ``recording`` (folder with
``videos``), ``target`` (a target file).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import posefuse as pf
from posefuse.api.calibrate import observe_target, target_of
from posefuse.calibration.report import RefusedCalibration
from posefuse.calibration.targets.kinds import Target
from posefuse.core import InputError
from posefuse_studio.calibrations import (
    FLOOR_ID,
    LENSES,
    RIG,
    StepResult,
    check_target,
    rests_on,
    without_floor,
)
from posefuse_studio.workspace import StudioWorkspace, write_stored

CLOCKS = "posefuse.toml"
# rows of boards and cubes need not be looked at 30 times a second
_EVERY = 2


def run(arguments: Mapping[str, Any], workspace: StudioWorkspace, progress: Any) -> dict[str, Any]:
    """Do the step; its `StepResult` is kept as ``STEP.json`` in the calibration's folder."""
    steps = {"intrinsics": _intrinsics, "extrinsics": _extrinsics, "verify": _verify}
    step = arguments["step"]
    if step not in steps:
        raise InputError(f"calibrate: unknown step {step!r}")
    recording, folder = (workspace.existing(str(arguments[name])) for name in ("recording", "folder"))
    videos = {path.stem: path for path in sorted((recording / "videos").glob("*.mp4"))}
    target = target_of(workspace.existing(str(arguments["target"])))
    check_target(target, step)
    made_from = rests_on(folder, step)
    try:
        result = steps[step](folder, videos, target, progress)
    except RefusedCalibration as refused:
        result = StepResult(passed=False, reports=[refused.report])
    result = replace(result, recording=str(arguments["recording"]), rests_on=made_from)
    write_stored(folder / f"{step}.json", result)
    return {"passed": result.passed}


def _intrinsics(folder: Path, videos: Mapping[str, Path], target: Target, progress: Any) -> StepResult:
    found = pf.calibrate_intrinsics(videos, target=target, every=_EVERY, progress=progress)
    found.save(folder / LENSES, report=folder / "lenses.html", replace=True)
    return StepResult(passed=True, reports=list(found.reports.values()))


def _extrinsics(folder: Path, videos: Mapping[str, Path], target: Target, progress: Any) -> StepResult:
    seen = observe_target(videos, target=target, every=_EVERY, progress=progress)
    on_floor = len(seen.of_patches([FLOOR_ID])) > 0 and without_floor(target) != target
    found = pf.calibrate_extrinsics(
        seen,
        intrinsics=folder / LENSES,
        target=target,
        floor_marker=FLOOR_ID if on_floor else None,
        progress=progress,
    )
    found.save(folder / RIG, report=folder / "rig.html", replace=True)
    # those of an earlier calibration hold no longer
    (folder / CLOCKS).write_text(found.clock_settings, encoding="utf-8")
    return StepResult(
        passed=True,
        reports=[found.report],
        world="from the marker on the floor" if on_floor else "",
        position_cov_m2={name: np.asarray(one).tolist() for name, one in found.position_cov_m2.items()},
    )


def _verify(folder: Path, videos: Mapping[str, Path], target: Target, progress: Any) -> StepResult:
    found = pf.verify(folder / RIG, videos, target=target, every=_EVERY, progress=progress)
    found.save(folder / "verified.html", replace=True)
    return StepResult(passed=found.passed, reports=[found.report])
