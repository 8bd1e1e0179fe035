"""Targets to print: PDF pages of black squares at their true size, written as vectors.

A ruler of 100 mm stands on every page: measure it after printing, because printers scale pages to fit by default.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posefuse.calibration.settings import PAGES_M
from posefuse.core import ConfigError
from posefuse.core.arrays import Array

from .kinds import Charuco, Markers, black_modules, dictionary_of

_POINTS_PER_M = 72 / 0.0254
_MARGIN_M = 0.010
_RULER_M = 0.100
_FOOT_M = 0.022
# one per face of a cube of edge side * (modules + 2) / modules; where each goes does not matter
CUBE_IDS = range(6)


@dataclass(frozen=True)
class Sheet:
    """One page: black rectangles (x, y, width, height) in metres from the bottom left, thin lines, and a caption."""

    size_m: tuple[float, float]
    black_m: tuple[tuple[float, float, float, float], ...]
    outline_m: tuple[tuple[float, float, float, float], ...]
    caption: str


def marker_sheets(target: Markers, ids: Sequence[int], page: str = "a4") -> list[Sheet]:
    """One page per marker, with the outline of the smallest face it may be glued to (a quiet zone of one module)."""
    sheets = []
    for marker in ids:
        bits = _bits(target.dictionary, marker)
        module = target.side_m / len(bits)
        face = target.side_m + 2 * module
        size, (left, bottom) = _placed(page, face, face)
        edges_m = module * np.arange(len(bits) + 3)
        squares = _rectangles(bits, left + edges_m[1:-1], bottom + edges_m[1:-1])
        edge = "black edge"
        if target.inverted:
            squares, edge = _rectangles(~np.pad(bits, 1), left + edges_m, bottom + edges_m), "white edge"
        caption = f"posefuse marker {marker}, {target.dictionary}, side {target.side_m * 1e3:g} mm ({edge})"
        sheets.append(Sheet(size, squares, ((left, bottom, face, face),), caption))
    return sheets


def board_sheet(target: Charuco, page: str = "a3") -> Sheet:
    """A board on one page, long side along the long side of the page."""
    width, height = target.columns * target.square_m, target.rows * target.square_m
    size, (left, bottom) = _placed(page, width, height)
    # OpenCV draws the board itself: what is printed is what is looked for. It rounds markers to whole px, so it draws them with a
    # border of one module, and px are as wide as they have to be
    modules, px = len(_bits(target.dictionary, 0)), 8
    cell, border_m = px * (modules + 2), (target.square_m - target.marker_m) / 2
    board = replace(target, marker_m=target.square_m * modules / (modules + 2)).board()
    image = board.generateImage((target.columns * cell, target.rows * cell), marginSize=0, borderBits=1)
    if target.inverted:
        image = 255 - image

    def edges_m(squares: int) -> Array:
        at, in_square = np.divmod(np.arange(squares * cell + 1), cell)
        corners_m = (0, border_m, target.square_m - border_m, target.square_m)
        return at * target.square_m + np.interp(in_square, (0, px, cell - px, cell), corners_m)

    caption = (
        f"posefuse ChArUco {target.columns} x {target.rows} squares of {target.square_m * 1e3:g} mm, markers"
        f" {target.marker_m * 1e3:g} mm, {target.dictionary}"
    )
    return Sheet(size, _rectangles(image < 128, left + edges_m(target.columns), bottom + edges_m(target.rows)), (), caption)


def _bits(dictionary: str, marker: int) -> Array:
    """(n, n) bool, True is black, border included."""
    made = dictionary_of(dictionary)
    if not 0 <= marker < len(made.bytesList):
        raise ConfigError(f"marker {marker}: {dictionary} has ids 0 to {len(made.bytesList) - 1}")
    return black_modules(made, marker)


def _rectangles(black: Array, x_m: Array, y_m: Array) -> tuple[tuple[float, float, float, float], ...]:
    """Black cells (rows, columns) as few rectangles: runs along a row, equal runs of neighbouring rows joined.

    Args:
        x_m: (columns + 1,) edges from the left. y_m: (rows + 1,) edges from the bottom.
    """
    out: list[tuple[float, float, float, float]] = []
    open_runs: dict[tuple[int, int], int] = {}
    rows = len(black)
    for row in range(rows + 1):
        line = np.concatenate([[False], black[row], [False]]) if row < rows else np.zeros(black.shape[1] + 2, bool)
        edges = np.flatnonzero(np.diff(line.astype(np.int8)))
        runs = {(int(a), int(b)) for a, b in edges.reshape(-1, 2)}
        for run in [run for run in open_runs if run not in runs]:
            first = open_runs.pop(run)
            (left, right), (bottom, top) = x_m[list(run)], y_m[[rows - row, rows - first]]
            out.append((float(left), float(bottom), float(right - left), float(top - bottom)))
        for run in runs:
            open_runs.setdefault(run, row)
    return tuple(sorted(out))


def _placed(page: str, width: float, height: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Page size, turned to fit, and the bottom left of a drawing in its middle above the ruler."""
    if page not in PAGES_M:
        raise ConfigError(f"page: expected one of {', '.join(PAGES_M)}, got {page!r}")
    for size in (PAGES_M[page], PAGES_M[page][::-1]):
        room = (size[0] - 2 * _MARGIN_M, size[1] - 2 * _MARGIN_M - _FOOT_M)
        if width <= room[0] and height <= room[1]:
            return size, ((size[0] - width) / 2, _MARGIN_M + _FOOT_M + (room[1] - height) / 2)
    area_m2 = PAGES_M[page][0] * PAGES_M[page][1]
    larger = ", ".join(name for name, (across, up) in PAGES_M.items() if across * up > area_m2)
    raise ConfigError(
        f"page {page}: a drawing of {width * 1e3:.0f} x {height * 1e3:.0f} mm, with its white border, does not fit with margins"
        f" and ruler; take {f'a larger page ({larger}) or ' if larger else ''}a smaller side"
    )


def write_pdf(path: Path, sheets: Sequence[Sheet]) -> None:
    """PDF 1.4 with one page per sheet."""
    objects: list[bytes] = [b"<< /Type /Catalog /Pages 2 0 R >>", b"", b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>"]
    kids = []
    for sheet in sheets:
        content = _content(sheet)
        objects.append(b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content))
        width, height = (side * _POINTS_PER_M for side in sheet.size_m)
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4f} {height:.4f}] /Contents {len(objects)} 0 R"
            " /Resources << /Font << /F1 3 0 R >> >> >>".encode()
        )
        kids.append(f"{len(objects)} 0 R")
    objects[1] = f"<< /Type /Pages /Count {len(kids)} /Kids [{' '.join(kids)}] >>".encode()
    text, offsets = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, start=1):
        offsets.append(len(text))
        text += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    count = len(objects) + 1
    trailer = b"trailer\n<< /Size %d /Root 1 0 R /ViewerPreferences << /PrintScaling /None >> >>\n" % count
    text += b"xref\n0 %d\n0000000000 65535 f \n%s%sstartxref\n%d\n%%%%EOF\n" % (count, table, trailer, len(text))
    path.write_bytes(text)


def _content(sheet: Sheet) -> bytes:
    def box(rectangle: tuple[float, float, float, float]) -> str:
        return " ".join(f"{value * _POINTS_PER_M:.4f}" for value in rectangle) + " re"

    # one path, one fill: rectangles filled one by one would show hairlines where they meet
    lines = ["0 g", *(box(rectangle) for rectangle in sheet.black_m), "f"]
    lines += ["0.6 G 0.3 w", *(f"{box(rectangle)} S" for rectangle in sheet.outline_m)]
    left, low = _MARGIN_M * _POINTS_PER_M, _MARGIN_M * _POINTS_PER_M
    end, tick = left + _RULER_M * _POINTS_PER_M, 0.004 * _POINTS_PER_M
    lines += [f"0 G 0.5 w {left:.4f} {low:.4f} m {end:.4f} {low:.4f} l S"]
    lines += [f"{x:.4f} {low:.4f} m {x:.4f} {low + tick:.4f} l S" for x in np.linspace(left, end, 11)]
    lines += [
        f"BT /F1 8 Tf {left:.2f} {low + 2.2 * tick:.2f} Td (100 mm: measure it. Print at 100 %, never 'fit to page'.) Tj ET",
        f"BT /F1 8 Tf {left:.2f} {low + 3.3 * tick:.2f} Td ({sheet.caption.replace('(', '[').replace(')', ']')}) Tj ET",
    ]
    return "\n".join(lines).encode("latin-1")
