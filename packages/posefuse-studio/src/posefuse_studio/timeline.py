"""Curves over the time of a recording as SVG, with gait events, stretches that are left out, and a cursor."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.palette import LEFT, MIDDLE, RIGHT
from posefuse.pipeline.edits import Exclusion

SIZE_PX = (1200, 260)
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 12, 14, 30
_MOST_POINTS = 600
COLOURS = {"left": LEFT.on_light, "right": RIGHT.on_light, "mid": MIDDLE.on_light}


@dataclass(frozen=True, eq=False)
class Curve:
    """Values (T,) with a name; `side`: ``left``, ``right`` or ``mid``, which gives its colour."""

    name: str
    values: Array
    side: str = "mid"


@dataclass(frozen=True)
class Span:
    """The time that the image shows, in seconds."""

    begin_s: float
    end_s: float

    def x_px(self, t_s: float) -> float:
        """Where a time lies."""
        share = (t_s - self.begin_s) / max(self.end_s - self.begin_s, 1e-9)
        return _LEFT + share * (SIZE_PX[0] - _LEFT - _RIGHT)

    def t_s(self, x_px: float) -> float:
        """The time at a place, within the span."""
        share = (x_px - _LEFT) / (SIZE_PX[0] - _LEFT - _RIGHT)
        return self.begin_s + float(np.clip(share, 0, 1)) * (self.end_s - self.begin_s)


def picture(t_s: Array, curves: Sequence[Curve], strikes: Mapping[str, Array], unit: str, empty: str = "") -> str:
    """An SVG image as the address of itself: curves over time, foot strikes as ticks at the bottom.

    Args:
        t_s: (T,) session seconds. strikes: by side, session seconds. empty: the text where there is no curve.
    """
    span = Span(float(t_s[0]), float(t_s[-1]))
    low, high = _range(curves)
    parts = [_times(span)] + ([_levels(low, high, unit)] if curves else [])
    parts += [_line(span, t_s, one, low, high) for one in curves]
    parts += [_ticks(span, times, COLOURS[side]) for side, times in strikes.items()]
    names = " ".join(
        f'<tspan fill="{COLOURS[one.side]}" dx="14">{escape(one.name)}</tspan>' for one in curves
    ) or f'<tspan fill="#78909c" dx="14">{escape(empty)}</tspan>'  # fmt: skip
    parts.append(f'<text x="{_LEFT}" y="{_TOP + 8}" font-size="15" font-weight="600">{names}</text>')
    width, height = SIZE_PX
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'font-family="Roboto, sans-serif">{"".join(parts)}</svg>'
    )
    return f"data:image/svg+xml;base64,{base64.b64encode(text.encode()).decode()}"


def cursor(span: Span, t_s: float, exclusions: Sequence[Exclusion], marked_s: tuple[float, float] | None) -> str:
    """Overlays of the image: the time, excluded ranges, the range that is being marked."""
    height = SIZE_PX[1]
    bands = [(one.start_s, one.end_s, "#e53935", one.camera or "all cameras") for one in exclusions]
    if marked_s is not None:
        bands.append((*marked_s, "#ffb300", ""))
    parts = []
    for begin_s, end_s, colour, name in bands:
        left, right = (span.x_px(float(np.clip(t, span.begin_s, span.end_s))) for t in (begin_s, end_s))
        shape = f'x="{left:.1f}" y="{_TOP}" width="{max(right - left, 1):.1f}" height="{height - _TOP - _BOTTOM}"'
        parts.append(f'<rect {shape} fill="{colour}" fill-opacity="0.22"/>')
        parts.append(f'<text x="{left + 4:.1f}" y="{height - _BOTTOM - 6}" font-size="13" fill="{colour}">{escape(name)}</text>')
    x = span.x_px(t_s)
    parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP}" y2="{height - _BOTTOM}" stroke="#00897b" stroke-width="2.5"/>')
    parts.append(f'<circle cx="{x:.1f}" cy="{_TOP}" r="6" fill="#00897b"/>')
    return "".join(parts)


def _range(curves: Sequence[Curve]) -> tuple[float, float]:
    known = np.concatenate([one.values[np.isfinite(one.values)] for one in curves] or [np.zeros(0)])
    if not len(known):
        return -1.0, 1.0
    low, high = float(known.min()), float(known.max())
    room = 0.08 * (high - low) + 1e-3
    return low - room, high + room


def _y_px(value: float, low: float, high: float) -> float:
    return SIZE_PX[1] - _BOTTOM - (value - low) / (high - low) * (SIZE_PX[1] - _TOP - _BOTTOM)


def _levels(low: float, high: float, unit: str) -> str:
    """Lines at round values."""
    width = SIZE_PX[0]
    parts = []
    for value in _round_values(low, high, 4):
        y = _y_px(value, low, high)
        parts.append(
            f'<line x1="{_LEFT}" x2="{width - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#90a4ae" stroke-opacity="0.35"/>'
        )
        parts.append(
            f'<text x="{_LEFT - 8}" y="{y + 5:.1f}" font-size="14" fill="#78909c" text-anchor="end">{value:g}{unit}</text>'
        )
    return "".join(parts)


def _times(span: Span) -> str:
    """Round times below."""
    style = 'font-size="14" fill="#78909c" text-anchor="middle"'
    return "".join(
        f'<text x="{span.x_px(value):.1f}" y="{SIZE_PX[1] - 8}" {style}>{value:g} s</text>'
        for value in _round_values(span.begin_s, span.end_s, 8)
    )


def _round_values(low: float, high: float, about: int) -> list[float]:
    """Round numbers in a range, about so many."""
    rough = max(high - low, 1e-9) / about
    size = 10.0 ** np.floor(np.log10(rough))
    step = size * next(factor for factor in (1, 2, 5, 10) if factor * size >= rough)
    # no negative zero
    return [float(round(value, 9)) + 0.0 for value in np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step]


def _line(span: Span, t_s: Array, curve: Curve, low: float, high: float) -> str:
    """A curve with gaps where values are missing; of a long recording every n-th value."""
    every = max(1, len(t_s) // _MOST_POINTS)
    path, pen = [], "M"
    for t, value in zip(t_s[::every].tolist(), curve.values[::every].tolist(), strict=True):
        if not np.isfinite(value):
            pen = "M"
            continue
        path.append(f"{pen}{span.x_px(t):.1f} {_y_px(value, low, high):.1f}")
        pen = "L"
    return f'<path d="{" ".join(path)}" fill="none" stroke="{COLOURS[curve.side]}" stroke-width="2"/>'


def _ticks(span: Span, times_s: Array, colour: str) -> str:
    bottom = SIZE_PX[1] - _BOTTOM
    return "".join(
        f'<line x1="{span.x_px(t):.1f}" x2="{span.x_px(t):.1f}" y1="{bottom - 10}" y2="{bottom + 4}" stroke="{colour}" '
        'stroke-width="3"/>'
        for t in times_s.tolist()
    )
