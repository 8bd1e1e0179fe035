"""What a calibration leaves behind: rig file, report, coverage image, and the clock offsets as settings of `posefuse track`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2

from posefuse.core import Rig
from posefuse.core.arrays import Array
from posefuse.formats.page import write_page
from posefuse.formats.rig import write_rig
from posefuse.foundation.output_file import atomic_file, keep_copy

from .clocks.sync import ClockEstimate
from .report import CalibrationReport
from .report_page import calibration_page
from .targets.corners import CornerObservations
from .targets.coverage import TargetCoverage, coverage, coverage_sheet


def write_calibration_report(
    path: Path, report: CalibrationReport, pictures: Mapping[str, Array], rig: Rig | None = None
) -> None:
    """The HTML page with images by caption (RGB arrays); an older one is kept as NAME.replaced-TIME."""
    keep_copy(path)
    write_page(path, calibration_page(report, pictures, rig))


def write_rig_file(path: Path, rig: Rig) -> None:
    """The rig file; an older one is kept as NAME.replaced-TIME."""
    keep_copy(path)
    write_rig(path, rig)


def numbered(path: Path, name: str, count: int) -> Path:
    """The report's path for one camera of several."""
    return path if count == 1 else path.with_stem(f"{path.stem}_{name}")


def coverage_path(rig_path: Path) -> Path:
    """Where the coverage image of a rig file goes."""
    return rig_path.with_name(f"{rig_path.stem}_coverage.png")


def write_coverage(path: Path, observations: CornerObservations) -> TargetCoverage:
    """The coverage image: which part of each image the target has covered."""
    found = coverage(observations)
    _, png = cv2.imencode(".png", cv2.cvtColor(coverage_sheet(found, observations.sizes_wh), cv2.COLOR_RGB2BGR))
    keep_copy(path)
    with atomic_file(path) as temporary:
        temporary.write_bytes(png.tobytes())
    return found


def clock_settings(names: Sequence[str], clocks: ClockEstimate) -> str:
    """The clock offsets as settings that `posefuse track` reads (TOML); empty where the cameras are synchronised.

    A frame stamped s was taken at s - offset - drift * (s - middle), and `track` adds its settings: the signs turn.
    """
    if not (clocks.offset_s.any() or clocks.drift.any()):
        return ""
    return "\n".join(_of_camera(name, *clocks.correction(c)) for c, name in enumerate(names))


def _of_camera(camera: str, offset_s: float, drift_ppm: float) -> str:
    """One camera's table in `posefuse.toml`; drift only where it was estimated."""
    table = f"[cameras.{json.dumps(camera)}]\noffset_s = {offset_s:.6f}\n"
    return table + (f"drift_ppm = {drift_ppm:.3f}\n" if drift_ppm else "")
