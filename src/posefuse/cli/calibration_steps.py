"""What the steps of `posefuse calibrate` share: checks of what their options name, and the report of one that is refused."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from posefuse.core import InputError

from .terminal import option_of, quoted


def option_words(options: Any, names: Sequence[str]) -> str:
    """Those of the options with these names that were given, as they are typed."""
    given = {name: value for name in names if (value := getattr(options, name)) is not None}
    return " ".join(f"--{option_of(name)} {quoted(value)}" for name, value in given.items())


def clock_offsets_s(offsets: Sequence[str]) -> dict[str, float]:
    """Clock offsets in s by camera name, from texts ``CAMERA=MS``."""
    found: dict[str, float] = {}
    for text in offsets:
        name, _, value = text.partition("=")
        try:
            found[name] = float(value) / 1e3
        except ValueError:
            found[name] = math.nan
        if not math.isfinite(found[name]):
            raise InputError(f"--offset-ms {text}: expected CAMERA=MILLISECONDS")
    return found


def check_files(options: Any, inputs: Sequence[str] = ()) -> list[Path]:
    """Raise InputError before any work where a file that the step will write cannot be, or exists without --force.

    Args:
        options: of the step. inputs: ``NAME=PATH`` texts of recordings.

    Returns:
        What the step reads: the recordings, and the files that its options name.
    """
    from posefuse.calibration.targets.recordings import paths_by_camera
    from posefuse.foundation.output_file import check_output_file

    named = [getattr(options, name, None) for name in ("target", "intrinsics", "rig", "floor_points")]
    read = [*paths_by_camera(inputs).values(), *(path for path in named if path is not None)]
    for name in ("out", "report"):
        if (path := getattr(options, name, None)) is not None:
            check_output_file(path, option=f"--{option_of(name)}", inputs=read, replace=options.replace)
            if name == "out" and path.suffix != ".toml":
                raise InputError(f"--out {path}: a rig file is TOML: expected a name that ends in .toml")
    return read


@contextmanager
def reported(path: Path | None) -> Iterator[None]:
    """Write the report of a refused calibration before the error is raised further."""
    from posefuse.calibration.report import RefusedCalibration

    try:
        yield
    except RefusedCalibration as refused:
        if path is not None:
            refused.report.save(path)
        raise
