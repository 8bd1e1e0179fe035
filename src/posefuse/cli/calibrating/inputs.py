"""What the user wrote on the command line of `posefuse calibrate`, as recordings, targets and clock offsets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from posefuse.calibration.targets.kinds import ArucoBoard, Charuco, Chessboard, Markers, Target
from posefuse.cli.options.calibration import TargetOptions
from posefuse.core import InputError, Rig
from posefuse.foundation.output_file import check_output_file


def target_of(options: TargetOptions) -> Target:
    """The target described; raises InputError naming the sizes that are missing."""

    def need(*names: str) -> list[Any]:
        missing = [f"--{name.replace('_', '-')}" for name in names if getattr(options, name) is None]
        if missing:
            raise InputError(f"--target {options.target}: missing {', '.join(missing)}")
        return [getattr(options, name) / 1e3 if name.endswith("_mm") else getattr(options, name) for name in names]

    if options.target == "markers":
        (side,) = need("marker_mm")
        return Markers(side, options.dictionary, options.ids, options.inverted)
    if options.target == "charuco":
        columns, rows, square, marker = need("columns", "rows", "square_mm", "marker_mm")
        return Charuco(
            columns=columns,
            rows=rows,
            square_m=square,
            marker_m=marker,
            dictionary=options.dictionary,
            inverted=options.inverted,
            legacy=options.legacy,
        )
    if options.target == "chessboard":
        columns, rows, square = need("columns", "rows", "square_mm")
        return Chessboard(columns, rows, square)
    columns, rows, side, gap = need("columns", "rows", "marker_mm", "gap_mm")
    return ArucoBoard(
        columns=columns,
        rows=rows,
        side_m=side,
        gap_m=gap,
        dictionary=options.dictionary,
        first_id=options.ids[0] if options.ids else 0,
        inverted=options.inverted,
    )


def recordings_of(inputs: Sequence[str]) -> dict[str, Path]:
    """``NAME=PATH`` texts as recordings by camera name, which defaults to the file's; raises InputError for one name twice."""
    named: dict[str, Path] = {}
    for text in inputs:
        name, equals, path = text.partition("=")
        camera, file = (name, Path(path)) if equals else (Path(text).stem, Path(text))
        if camera in named:
            raise InputError(f"{text}: camera {camera} has a recording already ({named[camera]}); name them as NAME=PATH")
        named[camera] = file
    return named


def clock_offsets_s(offsets: Sequence[str], rig: Rig) -> dict[str, float]:
    """Clock offsets in s by camera name, from texts ``CAMERA=MS``."""
    found: dict[str, float] = {}
    for text in offsets:
        name, _, value = text.partition("=")
        try:
            found[rig[name].name] = float(value) / 1e3
        except ValueError:
            raise InputError(f"--offset-ms {text}: expected CAMERA=MILLISECONDS") from None
    return found


def check_files(inputs: Sequence[str | Path | None], outputs: Sequence[tuple[str, Path | None]], *, force: bool) -> None:
    """Raise InputError before any work where a file that the step will write cannot be, or exists without --force.

    Args:
        inputs: what is read: ``NAME=PATH`` texts and paths. outputs: option and file.
    """
    texts = [text for text in inputs if isinstance(text, str)]
    read = [*recordings_of(texts).values(), *(path for path in inputs if isinstance(path, Path))]
    for option, path in outputs:
        if path is not None:
            check_output_file(path, option=option, inputs=read, replace=force)
