"""Times of the images of a folder: ``timestamps.csv`` with the columns file and t_s."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterable
from pathlib import Path

from posefuse.core import SourceError
from posefuse.foundation.parsing import one_line

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


def write_frame_times(folder: Path, times: Iterable[tuple[str, int]]) -> None:
    """Write the names of images and their times in ns."""
    with (folder / TIMES_FILE).open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["file", "t_s"])
        table.writerows([name, f"{t_ns / 1e9:.9f}"] for name, t_ns in times)
