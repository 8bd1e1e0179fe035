"""One self-contained HTML page of headings, tables, plots and pictures."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.evaluation.report.style import STYLE
from posefuse.foundation.atomic import atomic_file

WIDTH, HEIGHT = 420, 260
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 12, 40, 36
# of a letter of the legend
_LETTER_PX = 5.6
_MOST_POINTS = 900
_STYLE = (
    ".plot{width:100%;height:auto}.plots{display:grid;grid-template-columns:repeat(auto-fill,minmax(380px,1fr));gap:16px}"
    ":root{--c0:#2468c9;--c1:#d2542c;--c2:#4c7a51;--c3:#8a5cc2;--c4:#8b6b1f;--c5:#66707d}"
    ".plots.many{grid-template-columns:repeat(auto-fill,minmax(300px,1fr))}.spike{stroke-width:3}.wide{grid-column:1/-1}"
    ".plots{margin-top:14px}table+table{margin-top:10px}"
    "@media (prefers-color-scheme:dark){:root{--c0:#6ea5f5;--c1:#f08a63;--c2:#86b98b;--c3:#b694e6;--c4:#d0ae5a;--c5:#98a2b0}}"
    + "".join(f".s{i}{{stroke:var(--c{i});fill:none}}.f{i}{{fill:var(--c{i})}}" for i in range(6))
    + "td.best{font-weight:600}code{font-size:12px;word-break:break-all}"
)


@dataclass(frozen=True, eq=False)
class Line:
    """One line of a plot: x and y (n,), NaN for gaps; `colour` 0 to 5, None: by its place.

    `dots` draws points, not a line; `spikes` a line thick enough to stand alone.
    """

    name: str
    x: Array
    y: Array
    dots: bool = False
    colour: int | None = None
    spikes: bool = False


class Page:
    """A page in the making; every method adds below what is there."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._parts = [f"<header><h1>{escape(title)}</h1></header>"]

    def section(self, heading: str, text: str = "") -> None:
        """A heading, and a paragraph under it."""
        note = f'<p class="note">{escape(text)}</p>' if text else ""
        self._parts.append(f"<section><h2>{escape(heading)}</h2>{note}</section>")

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
        """A table; the first column is text, numbers are shown to one digit after the point."""
        head = "".join(f"<th>{escape(name)}</th>" for name in columns)
        body = "".join(
            f"<tr><th>{escape(_cell(row[0]))}</th>" + "".join(f"<td>{escape(_cell(cell))}</td>" for cell in row[1:]) + "</tr>"
            for row in rows
        )
        self._into(f"<table><tr>{head}</tr>{body}</table>")

    def facts(self, facts: Mapping[str, Any]) -> None:
        """Names and values."""
        cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(_cell(value))}</td></tr>" for name, value in facts.items())
        self._into(f'<table class="narrow">{cells}</table>')

    def plots(self, plots: Sequence[str], many: bool = False) -> None:
        """Drawings of `plot` side by side, in two columns or, if they are `many`, in three."""
        self._into(f'<div class="plots{" many" if many else ""}">{"".join(plots)}</div>')

    def pictures(self, pictures: Mapping[str, Array]) -> None:
        """Captions to RGB images, stored inside the page."""
        figures = [
            f'<figure><img alt="{escape(caption)}" src="data:image/jpeg;base64,{_jpeg(image)}">'
            f"<figcaption>{escape(caption)}</figcaption></figure>"
            for caption, image in pictures.items()
        ]
        self._into(f'<div class="pictures">{"".join(figures)}</div>')

    def write(self, path: Path) -> Path:
        """Write the page, whole or not at all."""
        html = (
            '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
            f"<title>{escape(self._title)}</title><style>{STYLE}{_STYLE}</style></head><body><main>"
            f"{''.join(self._parts)}</main></body></html>\n"
        )
        with atomic_file(path) as beside:
            beside.write_text(html, encoding="utf-8")
        return path

    def _into(self, html: str) -> None:
        last = self._parts[-1]
        if last.endswith("</section>"):
            self._parts[-1] = last.removesuffix("</section>") + html + "</section>"
        else:
            self._parts.append(f"<section>{html}</section>")


def plot(
    title: str,
    x_label: str,
    y_label: str,
    lines: Sequence[Line],
    equal: bool = False,
    from_zero: bool = False,
    wide: bool = False,
    window: tuple[float, float, float, float] | None = None,
) -> str:
    """Lines over a common x as <svg>, with a legend.

    `equal`: one scale on both axes; `from_zero`: y begins at 0; `wide`: twice as wide, over all columns of `Page.plots`;
    `window`: least and greatest x, least and greatest y, where several plots are to be compared.
    """
    width = 2 * WIDTH if wide else WIDTH
    (x_low, x_high), (y_low, y_high) = _limits([one.x for one in lines]), _limits([one.y for one in lines])
    y_low = 0.0 if from_zero else y_low
    x_low, x_high, y_low, y_high = window or (x_low, x_high, y_low, y_high)
    across_px, high = width - _LEFT - _RIGHT, HEIGHT - _TOP - _BOTTOM
    if equal:
        metres_px = max((x_high - x_low) / across_px, (y_high - y_low) / high)
        x_middle, y_middle = (x_low + x_high) / 2, (y_low + y_high) / 2
        x_low, x_high = x_middle - metres_px * across_px / 2, x_middle + metres_px * across_px / 2
        y_low, y_high = y_middle - metres_px * high / 2, y_middle + metres_px * high / 2

    def across(x: Array | float) -> Array:
        return np.asarray(_LEFT + across_px * (np.asarray(x) - x_low) / (x_high - x_low))

    def up(y: Array | float) -> Array:
        return np.asarray(HEIGHT - _BOTTOM - high * (np.asarray(y) - y_low) / (y_high - y_low))

    parts = [
        f'<svg class="plot{" wide" if wide else ""}" viewBox="0 0 {width} {HEIGHT}" role="img" aria-label="{escape(title)}">',
        f'<text class="title" x="4" y="15">{escape(title)} [{escape(y_label)}]</text>',
        f'<text x="{width - _RIGHT}" y="{HEIGHT - 6}" text-anchor="end">{escape(x_label)}</text>',
    ]
    for value in _ticks(y_low, y_high):
        y = float(up(value))
        parts.append(f'<line class="grid" x1="{_LEFT}" x2="{width - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{_LEFT - 5}" y="{y + 3:.1f}" text-anchor="end">{value:g}</text>')
    for value in _ticks(x_low, x_high):
        x = float(across(value))
        parts.append(f'<text x="{x:.1f}" y="{HEIGHT - _BOTTOM + 14}" text-anchor="middle">{value:g}</text>')
    colours = [i % 6 if line.colour is None else line.colour for i, line in enumerate(lines)]
    parts += [_drawn(line, colour, across, up) for line, colour in zip(lines, colours, strict=True)]
    parts += _legend([line.name for line in lines], colours)
    return "".join(parts) + "</svg>"


def bars(title: str, unit: str, rows: Mapping[str, Sequence[float]], parts_named: Sequence[str]) -> str:
    """One lying bar per row as <svg>, its parts (in the order of their names) end to end, the sum written behind it."""
    step, thick, left, right = 22, 14, 118, 44
    height = _TOP + 6 + step * len(rows)
    most = max((float(np.sum(values)) for values in rows.values()), default=0.0) or 1.0
    wide = 2 * WIDTH - left - right
    out = [
        f'<svg class="plot wide" viewBox="0 0 {2 * WIDTH} {height}" role="img" aria-label="{escape(title)}">',
        f'<text class="title" x="4" y="15">{escape(title)} [{escape(unit)}]</text>',
        *_legend(parts_named, [i % 6 for i in range(len(parts_named))]),
    ]
    for row, (name, values) in enumerate(rows.items()):
        y, x = _TOP + step * row, float(left)
        out.append(f'<text x="{left - 6}" y="{y + 11}" text-anchor="end">{escape(name)}</text>')
        for i, value in enumerate(values):
            length = wide * float(value) / most
            hint = f"<title>{escape(parts_named[i])} {value:.1f} {escape(unit)}</title>"
            out.append(f'<rect class="f{i % 6}" x="{x:.1f}" y="{y}" width="{length:.1f}" height="{thick}">{hint}</rect>')
            x += length
        out.append(f'<text x="{x + 5:.1f}" y="{y + 11}">{np.sum(values):.1f}</text>')
    return "".join(out) + "</svg>"


def _legend(names: Sequence[str], colours: Sequence[int]) -> list[str]:
    parts, x = [], float(_LEFT)
    for name, colour in zip(names, colours, strict=True):
        parts.append(f'<rect class="f{colour}" x="{x:.0f}" y="25" width="10" height="4"/>')
        parts.append(f'<text x="{x + 14:.0f}" y="31">{escape(name)}</text>')
        x += 26 + _LETTER_PX * len(name)
    return parts


def _drawn(line: Line, colour: int, across: Any, up: Any) -> str:
    step = max(1, len(line.x) // _MOST_POINTS)
    x, y = across(line.x[::step]), up(line.y[::step])
    known = np.isfinite(x) & np.isfinite(y)
    if line.dots:
        return "".join(
            f'<circle class="f{colour}" cx="{a:.1f}" cy="{b:.1f}" r="1.6"/>' for a, b in zip(x[known], y[known], strict=True)
        )
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(int), [0]])))
    runs = zip(edges[::2], edges[1::2], strict=True)
    path = " ".join("M" + " L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x[i:j], y[i:j], strict=True)) for i, j in runs)
    return f'<path class="line s{colour}{" spike" if line.spikes else ""}" d="{path}"><title>{escape(line.name)}</title></path>'


def _limits(columns: Sequence[Array]) -> tuple[float, float]:
    values = np.concatenate([np.asarray(column, float).ravel() for column in columns])
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    room = 0.04 * (high - low) or 1.0
    return low - room, high + room


def _ticks(low: float, high: float) -> Array:
    raw = (high - low) / 5
    size = 10 ** np.floor(np.log10(raw))
    step = size * min((1, 2, 5, 10), key=lambda m: abs(m * size - raw))
    return np.asarray(np.round(np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step, 9) + 0.0)


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return (f"{value:.1f}" if abs(value) >= 0.1 or value == 0 else f"{value:.2g}") if np.isfinite(value) else "–"
    return str(value)


def _jpeg(image: Array) -> str:
    done, data = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 85])
    if not done:
        raise InputError(f"a picture of shape {image.shape} could not be encoded as JPEG")
    return base64.b64encode(data.tobytes()).decode()
