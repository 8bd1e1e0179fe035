"""TRC: marker trajectories as OpenSim reads them (tab-separated, Y up; read in m, cm or mm, written in m).

Converted at the door: (X, Y, Z) of the file = (Y, Z, X) of our world, which is Z up. A missing point is three cells of ``nan``,
as OpenSim itself writes it: its reader refuses a row whose last cell is empty. Empty cells are read, too.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.foundation.output_file import write_lines
from posefuse.foundation.parsing import one_line, read_text, short

from .named_points import NamedPoints

METRES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
# no recorded point is farther from the origin; one that is was written in millimetres
_FARTHEST_M = 200.0
# no set of markers is closer together than this; one that is was written in metres and labelled millimetres
_SMALLEST_M = 0.01
_HEADER_LINES = 5


@dataclass(frozen=True, eq=False, kw_only=True)
class TrcData(NamedPoints):
    """Named points over time; rate_hz: DataRate of the header."""

    rate_hz: float


def read_trc(path: Path | str) -> TrcData:
    """Read a TRC file.

    Raises:
        InputError: not a TRC file, no units, units that make the points impossibly far or small, or rows that do not fit
            the header; names file and line.
    """
    path = Path(path)
    lines = _lines(path)
    header = _header(path, lines)
    units = header.get("Units", "")
    if units not in METRES:
        raise InputError(f"{path}: line 3: Units: expected one of {choices(METRES)}, got {short(units)}; correct it in the file")
    names = _names(path, lines[3], header)
    rows = [_row(path, i + 1, line, len(names)) for i, line in enumerate(lines) if i >= _HEADER_LINES and line.strip()]
    if not rows:
        raise InputError(f"{path}: expected rows of points after the header, got none")
    table = np.array(rows)
    xyz_file = table[:, 1:].reshape(len(rows), len(names), 3) * METRES[units]
    _check_scale(path, xyz_file, units)
    return TrcData(names=names, t_s=table[:, 0], xyz_world=xyz_file[..., [2, 0, 1]], rate_hz=_rate(path, header))


def write_trc(path: Path | str, data: TrcData) -> None:
    """Write a TRC file that OpenSim opens; coordinates in metres with 7 digits after the point.

    Raises:
        InputError: the place cannot be written to, or a marker name holds a tab or a line break.
    """
    path = Path(path)
    bad = [name for name in data.names if not name or any(ch in name for ch in "\t\r\n")]
    if bad:
        raise InputError(f"{path}: marker names must not be empty or hold tabs, got {bad[0]!r}")
    rate, count = f"{data.rate_hz:g}", len(data.t_s)
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{count}\t{len(data.names)}\tm\t{rate}\t1\t{count}",
        "Frame#\tTime\t" + "\t\t\t".join(data.names) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(len(data.names)) for axis in "XYZ"),
        "",
    ]
    xyz_file = data.xyz_world[..., [1, 2, 0]].reshape(count, -1)
    rows = (_line(i + 1, t_s, row) for i, (t_s, row) in enumerate(zip(data.t_s, xyz_file, strict=True)))
    write_lines(path, itertools.chain(lines, rows))


def _line(number: int, t_s: float, row: Array) -> str:
    return "\t".join([str(number), f"{t_s:.6f}", *(f"{value:.7f}" for value in row)])


def _lines(path: Path) -> list[str]:
    lines = read_text(path).splitlines()
    if len(lines) < _HEADER_LINES or not lines[0].startswith("PathFileType"):
        raise InputError(f"{path}: not a TRC file: expected a first line that begins with PathFileType")
    return lines


def _header(path: Path, lines: list[str]) -> dict[str, str]:
    header = dict(zip(lines[1].split(), lines[2].split(), strict=False))
    for key in ("DataRate", "NumMarkers"):
        if key not in header:
            raise InputError(f"{path}: line 2: {key} is missing; there are: {one_line(choices(header))}")
    return header


def _rate(path: Path, header: dict[str, str]) -> float:
    try:
        rate_hz = float(header["DataRate"])
    except ValueError:
        rate_hz = math.nan
    if not (math.isfinite(rate_hz) and rate_hz > 0):
        raise InputError(f"{path}: DataRate: expected a number of Hz > 0, got {short(header['DataRate'])}")
    return rate_hz


def _names(path: Path, line: str, header: dict[str, str]) -> tuple[str, ...]:
    # writers disagree on the number of tabs between names, and some pad the end
    names = tuple(name.strip() for name in line.split("\t")[2:] if name.strip())
    if str(len(names)) != header["NumMarkers"]:
        raise InputError(f"{path}: line 4: expected NumMarkers = {header['NumMarkers']} names, got {len(names)}")
    return names


def _row(path: Path, number: int, line: str, markers: int) -> list[float]:
    cells = [cell.strip() for cell in line.split("\t")][1:]
    wanted = 1 + 3 * markers
    while len(cells) > wanted and not cells[-1]:
        cells.pop()
    if len(cells) > wanted:
        raise InputError(f"{path}: line {number}: expected {wanted + 1} cells, got {len(cells) + 1}")
    cells += [""] * (wanted - len(cells))
    try:
        row = [float(cell) if cell else math.nan for cell in cells]
    except ValueError as error:
        raise InputError(f"{path}: line {number}: {one_line(error)}") from None
    if not math.isfinite(row[0]):
        raise InputError(f"{path}: line {number}: expected a time, got {short(cells[0])}")
    return row


def _check_scale(path: Path, xyz_m: Array, units: str) -> None:
    seen = xyz_m[np.isfinite(xyz_m).all(axis=-1)]
    if len(seen) < 2:
        return
    size_m = float(np.ptp(seen, axis=0).max())
    if np.median(np.abs(seen)) > _FARTHEST_M or size_m < _SMALLEST_M:
        raise InputError(
            f"{path}: line 3: Units {units} give points that span {size_m:.3g} m; "
            f"they seem to be wrong: correct them in the file, to {'mm' if size_m > 1 else 'm'} perhaps"
        )
