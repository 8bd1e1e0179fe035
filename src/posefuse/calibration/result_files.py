"""What a calibration leaves behind: rig file, coverage image, and clock offsets as settings of `posefuse track`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from posefuse.core import Rig
from posefuse.core.arrays import Array
from posefuse.formats.rig import write_rig
from posefuse.foundation.output_file import atomic_file, keep_copy

from .clocks.sync import ClockEstimate
from .targets.corners import CornerObservations
from .targets.coverage import TargetCoverage, coverage, coverage_sheet


def heat_map_image(values: Array, size_wh: tuple[int, int], full: float) -> Array:
    """RGB image (H, W, 3) of values (rows, columns) over an image: green 0, red `full` and more, grey NaN."""
    level = np.clip(np.nan_to_num(values) / full, 0, 1)[..., None]
    colours = np.array([40, 170, 80]) * (1 - level) + np.array([200, 60, 40]) * level
    colours = np.where(np.isnan(values)[..., None], 128, colours).astype(np.uint8)
    picture = cv2.resize(colours, size_wh, interpolation=cv2.INTER_NEAREST)
    rows, columns = values.shape
    for row, column in np.argwhere(np.isfinite(values)):
        at = (round((column + 0.15) * size_wh[0] / columns), round((row + 0.6) * size_wh[1] / rows))
        cv2.putText(picture, f"{values[row, column]:.1f}", at, cv2.FONT_HERSHEY_SIMPLEX, size_wh[0] / 1600, (255, 255, 255), 1)
    return np.asarray(picture)


def write_rig_file(path: Path, rig: Rig) -> None:
    """The rig file; an older one is kept as NAME.replaced-TIME."""
    keep_copy(path)
    write_rig(path, rig)


def numbered(path: Path, name: str, count: int) -> Path:
    """The report's path for one camera of several."""
    return path if count == 1 else path.with_stem(f"{path.stem}_{name}")


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
