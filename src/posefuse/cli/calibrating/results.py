"""What `posefuse calibrate` shows and leaves behind beside the rig file: reports, the coverage picture, the clocks found."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.extrinsics.target import Calibration
from posefuse.calibration.report import CalibrationReport, RefusedCalibration
from posefuse.calibration.report_page import calibration_page
from posefuse.calibration.targets.corners import Observations
from posefuse.calibration.targets.coverage import coverage, coverage_sheet
from posefuse.cli.terminal import Terminal
from posefuse.core import Rig
from posefuse.core.arrays import Array
from posefuse.formats.page import write_page
from posefuse.formats.rig import write_rig
from posefuse.foundation.atomic import atomic_file
from posefuse.foundation.output_file import check_output_file, keep_copy
from posefuse.pipeline.config import read_config

from .inputs import name_and_path


def check_outputs(args: argparse.Namespace) -> None:
    """Raise InputError before any work where a file that the step will write cannot be, or is there without --force."""
    inputs = [name_and_path(text)[1] for text in getattr(args, "inputs", ())]
    inputs += [path for name in ("intrinsics", "rig", "floor_points") if (path := getattr(args, name, None)) is not None]
    outputs = [(f"--{name.replace('_', '-')}", getattr(args, name, None)) for name in ("out", "report", "view_file")]
    if args.step == "extrinsics":
        outputs.append(("--out", coverage_path(args.out)))
    for option, path in outputs:
        if path is not None:
            check_output_file(path, option=option, inputs=inputs, replace=args.force)


@contextmanager
def reported(args: argparse.Namespace) -> Iterator[None]:
    """Write the report of a refused calibration before the error goes on."""
    try:
        yield
    except RefusedCalibration as refused:
        write_report(args.report, refused.report, {})
        raise


def kept_if_asked(calibrate: Callable[[], Calibration], keep: bool, terminal: Terminal) -> Calibration:
    """The calibration; a refused one, marked as refused, where it was asked for and there is one."""
    try:
        return calibrate()
    except RefusedCalibration as refused:
        if not keep or refused.kept is None:
            raise
        terminal.warn(f"{refused}; kept all the same (--keep-refused), and marked as refused in the file")
        kept: Calibration = refused.kept
        return kept


def write_report(path: Path | None, report: CalibrationReport, pictures: Mapping[str, Any], rig: Rig | None = None) -> None:
    """The HTML page with images by caption (RGB arrays), where one was asked for."""
    if path is not None:
        keep_copy(path)
        write_page(path, calibration_page(report, pictures, rig))


def write_rig_file(path: Path, rig: Rig) -> None:
    """The rig file; an older one is kept beside it."""
    keep_copy(path)
    write_rig(path, rig)


def numbered(path: Path | None, name: str, count: int) -> Path | None:
    """The report's path for one camera of several."""
    return path if path is None or count == 1 else path.with_stem(f"{path.stem}_{name}")


def show(report: CalibrationReport, terminal: Terminal) -> None:
    """The checks as a table, and the notes."""
    rows = [("pass" if check.passed else "FAIL", check.name, check.line) for check in report.checks]
    terminal.table(report.subject, ("", "check", "found"), rows)
    for note in report.notes:
        terminal.note(f"note: {note}")


def coverage_path(rig_path: Path) -> Path:
    """Where the coverage picture of a rig file goes."""
    return rig_path.with_name(f"{rig_path.stem}_coverage.png")


def write_coverage(rig_path: Path, observations: Observations, terminal: Terminal) -> Path:
    """The picture of what the waving has met, before the solve: it is needed most when that refuses."""
    found, path = coverage(observations), coverage_path(rig_path)
    _, png = cv2.imencode(".png", cv2.cvtColor(coverage_sheet(found, observations.sizes_wh), cv2.COLOR_RGB2BGR))
    keep_copy(path)
    with atomic_file(path) as temporary:
        temporary.write_bytes(png.tobytes())
    terminal.note(f"{path}: {found.advice()}")
    return path


def frame_period_s(times_ns: Array) -> float:
    """Usual time between two frames."""
    return float(np.median(np.diff(times_ns))) / 1e9 if len(times_ns) > 1 else float("nan")


def show_clocks(names: Sequence[str], clocks: ClockEstimate, period_s: Sequence[float], terminal: Terminal) -> None:
    """A table of all cameras, in ms and in frames, which come every period_s (C,) s."""
    rows: list[list[Any]] = []
    for c, name in enumerate(names):
        offset, sigma = clocks.offset_s[c], clocks.offset_sigma_s[c]
        rows.append([name, _both(offset * 1e3, sigma * 1e3, 1), _both(offset / period_s[c], sigma / period_s[c], 2)])
        if clocks.drift_sigma.any():
            rows[-1].append(_both(clocks.drift[c] * 1e6, clocks.drift_sigma[c] * 1e6, 0))
    columns = ("camera", "stamps late by, ms", "in frames", "running fast by, ppm")
    terminal.table(f"clocks, against {names[0]}", columns[: len(rows[0])], rows)


def _both(value: float, sigma: float, digits: int) -> str:
    return f"{value:+.{digits}f} ± {sigma:.{digits}f}"


def clocks_of(found: Calibration) -> ClockEstimate:
    """What a calibration from a prop says of the cameras' clocks."""
    return ClockEstimate(*found.delay_s.T, *found.delay_sigma_s.T, found.middle_ns / 1e9)


def write_clocks(path: Path, names: Sequence[str], clocks: ClockEstimate, terminal: Terminal) -> Path | None:
    """The clocks that were found, as settings that `posefuse track` reads; a rig file cannot carry them.

    A frame stamped s was taken at s - offset - drift * (s - middle), and `track` adds its settings: the signs turn.
    Returns None when the cameras were in step, or the settings are somebody's already.
    """
    if not (clocks.offset_s.any() or clocks.drift.any()):
        _warn_of_old_clocks(path, names, terminal)
        return None
    text = "\n".join(_clock_settings(name, *clocks.correction(c)) for c, name in enumerate(names))
    if path.exists():
        terminal.warn(f"{path} is there already and is left as it is; the clocks found belong into it:\n{text}")
        return None
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    terminal.note(f"{path}: clocks of the cameras, for `posefuse track` of recordings made together with these")
    return path


def _warn_of_old_clocks(path: Path, names: Sequence[str], terminal: Terminal) -> None:
    """Say that clocks of another recording would be applied to cameras that are synchronised."""
    if not path.exists():
        return
    old = read_config(path, ()).cameras
    stale = [name for name in names if name in old and (old[name].offset_s or old[name].drift_ppm)]
    if stale:
        terminal.warn(
            f"{path} holds clock offsets of {', '.join(stale)}, but these cameras are synchronised: `posefuse track` would"
            " shift them; remove offset_s and drift_ppm there, or the file"
        )


def _clock_settings(camera: str, offset_s: float, drift_ppm: float) -> str:
    """One camera's table in `posefuse.toml`; drift only where it was estimated."""
    table = f"[cameras.{json.dumps(camera)}]\noffset_s = {offset_s:.6f}\n"
    return table + (f"drift_ppm = {drift_ppm:.3f}\n" if drift_ppm else "")
