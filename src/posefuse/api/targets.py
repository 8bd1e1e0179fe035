"""Targets, printed at their true size."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from posefuse.calibration.settings import TargetDescription
from posefuse.calibration.targets.kinds import Chessboard, Markers, Target, described_target, write_target
from posefuse.calibration.targets.printing import CUBE_IDS, board_sheet, marker_sheets, write_pdf
from posefuse.core import InputError
from posefuse.foundation.output_file import atomic_file, check_output_file, keep_copy
from posefuse.foundation.settings import settings_from_mapping


@dataclass(frozen=True, kw_only=True)
class PrintedTarget:
    """A target as a PDF, and its description, the target file that the calibrations take.

    Attributes:
        pdf, target: the files. pages: of the PDF. step: the calibration that it is for.
    """

    pdf: Path
    target: Path
    pages: int
    step: Literal["intrinsics", "extrinsics"]


def print_target(
    out: str | Path, settings: Mapping[str, Any], *, cube: bool = False, page: str = "a4", replace: bool = False
) -> PrintedTarget:
    """Make a PDF of a target at its true size, and its description next to it.

    Args:
        out: PDF to write; the description takes its name with ``.toml``.
        settings: content of a target file: ``kind``, ``columns``, ``rows``, ``square_mm``, ``marker_mm``, ``ids`` ...
        cube: six markers for a cube. page: paper: a4, a3, a2, a1, a0 or letter.
        replace: files that exist are kept as ``NAME.replaced-TIME``.

    Raises:
        InputError: a size is missing, or a file exists. ConfigError: a setting of another type, a target that cannot be, or does
            not fit on the page.

    Examples:
        >>> import posefuse as pf
        >>> board = {"kind": "charuco", "columns": 5, "rows": 7, "square_mm": 36, "marker_mm": 27}
        >>> pf.print_target("board.pdf", board).target.name  # doctest: +SKIP
        'board.toml'
    """
    pdf, described = Path(out), Path(out).with_suffix(".toml")
    for path in (pdf, described):
        check_output_file(path, option="out", replace=replace)
    kind = _described({**settings, **({"kind": "markers"} if cube else {})})
    if isinstance(kind, Chessboard):
        raise InputError("print: a plain chessboard is not offered; a ChArUco board does all it does, and more")
    if isinstance(kind, Markers):
        ids = kind.ids or (CUBE_IDS if cube else (0,))
        if cube and len(ids) != len(CUBE_IDS):
            raise InputError(f"`ids=A,B,...`: a cube has {len(CUBE_IDS)} markers, got {len(ids)}")
        # the file names them: a marker of the floor is not part of the target
        kind, sheets = dataclasses.replace(kind, ids=tuple(ids)), marker_sheets(kind, ids, page)
    else:
        sheets = [board_sheet(kind, page)]
    keep_copy(pdf)
    with atomic_file(pdf) as temporary:
        write_pdf(temporary, sheets)
    write_target(described, kind)
    step: Literal["intrinsics", "extrinsics"] = "extrinsics" if isinstance(kind, Markers) else "intrinsics"
    return PrintedTarget(pdf=pdf, target=described, pages=len(sheets), step=step)


def _described(settings: Mapping[str, Any]) -> Target:
    described = settings_from_mapping(settings, TargetDescription, where="target")

    def missing(names: Any) -> InputError:
        lacking = ", ".join(f"`{name}={'MM' if name.endswith('_mm') else 'N'}`" for name in names)
        return InputError(f"target {described.kind}: missing {lacking}")

    return described_target(described, missing)
