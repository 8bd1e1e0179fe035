"""Images of one camera as a folder: when each was taken, and depth images as 16-bit PNG files, lossless, each named by its time.

FOLDER/timestamps.csv     of frames, with the columns file and t_s

FOLDER/000001033333.png   depth along the optical axis in units of `unit_m`, 0 where unknown; the name is the time of the frame
                          that it belongs to, in microseconds of that camera's own file
FOLDER/depth.json         unit_m, and the noise of the camera as in `core.depth.DepthNoise`; may be missing: millimetres, and the
                          noise of a camera with a baseline of 5 cm
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import InputError, SourceError
from posefuse.core.arrays import Array
from posefuse.core.depth import DepthImage, DepthNoise
from posefuse.foundation.parsing import one_line, parse_json, read_text

TIMES_FILE = "timestamps.csv"
# times are int64 nanoseconds, and an offset comes on top
_LATEST_S = 4e9


def read_frame_times(folder: Path) -> list[tuple[Path, float]]:
    """Images of a folder and their times in seconds; raises SourceError for a damaged file, or times that do not increase."""
    path = folder / TIMES_FILE
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            times = [(folder / row["file"], float(row["t_s"])) for row in csv.DictReader(file)]
    except (OSError, KeyError, ValueError, TypeError, csv.Error) as error:
        raise SourceError(f"{path}: expected columns file, t_s with numbers, got {one_line(error)}") from None
    if not all(abs(time_s) < _LATEST_S for _, time_s in times):
        raise SourceError(f"{path}: t_s: expected seconds below {_LATEST_S:g}, got NaN, infinity or more")
    if any(later[1] <= earlier[1] for earlier, later in itertools.pairwise(times)):
        raise SourceError(f"{path}: expected strictly increasing t_s")
    return times


ABOUT_FILE = "depth.json"
# a depth image this close to a frame in time belongs to it
_SAME_NS = 2_000_000


def depth_name(t_ns: int) -> str:
    """File name of the image at a time: microseconds, so that names sort by time."""
    return f"{round(t_ns / 1000):012d}.png"


class DepthFolder:
    """The depth images of one camera; raises InputError for a folder that holds something else."""

    def __init__(self, folder: Path) -> None:
        self._paths = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".png")
        wrong = [path for path in self._paths if not path.stem.isdecimal()]
        if wrong or not self._paths:
            what = f"got {wrong[0].name}" if wrong else "got none"
            raise InputError(f"{folder}: expected depth images named by their time in microseconds, {what}")
        self._t_ns = np.array([int(path.stem) * 1000 for path in self._paths], np.int64)
        self._unit_m, self._noise = _about(folder / ABOUT_FILE)

    def at(self, t_ns: int, size_wh: tuple[int, int]) -> DepthImage | None:
        """The image of a frame at this time of the file; None where there is none. Raises InputError for a wrong one."""
        path = self._path_of(t_ns)
        return None if path is None else DepthImage(values=_read(path, size_wh), unit_m=self._unit_m, noise=self._noise)

    def check_times(self, t_ns: Sequence[int]) -> None:
        """Raise InputError where no image belongs to any frame at these times of the file: the names are in other times."""
        if not any(self._path_of(one_ns) for one_ns in t_ns):
            raise InputError(
                f"expected names in microseconds of the video's own time, but no image is within {_SAME_NS / 1e6:g} ms of "
                f"a frame (first image {self._paths[0].name}, first frame {depth_name(t_ns[0]) if len(t_ns) else 'missing'})"
            )

    def _path_of(self, t_ns: int) -> Path | None:
        nearest = int(np.abs(self._t_ns - t_ns).argmin())
        return self._paths[nearest] if abs(int(self._t_ns[nearest]) - t_ns) <= _SAME_NS else None


def _read(path: Path, size_wh: tuple[int, int]) -> Array:
    import cv2

    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if values is None or values.dtype != np.uint16 or values.ndim != 2:
        raise InputError(f"{path}: expected a depth image: a PNG file with one channel of 16 bits")
    if values.shape != (size_wh[1], size_wh[0]):
        raise InputError(f"{path}: {values.shape[1]}x{values.shape[0]} px, the colour image has {size_wh[0]}x{size_wh[1]}")
    return np.asarray(values)


def _about(path: Path) -> tuple[float, DepthNoise]:
    if not path.is_file():
        return DepthImage(values=np.zeros((1, 1), np.uint16)).unit_m, DepthNoise()
    content = parse_json(str(path), read_text(path))
    known = {field.name for field in fields(DepthNoise)}
    noise = content.get("noise", {}) if isinstance(content, Mapping) else None
    if not isinstance(noise, Mapping) or set(noise) - known or not _positive(content.get("unit_m")):
        raise InputError(f"{path}: expected unit_m > 0 and noise with {', '.join(sorted(known))}")
    if not all(isinstance(value, int | float) and value >= 0 for value in noise.values()):
        raise InputError(f"{path}: noise: expected numbers >= 0")
    return float(content["unit_m"]), DepthNoise(**noise)


def _positive(value: Any) -> bool:
    return isinstance(value, int | float) and 0 < value < 1
