"""Small drawings as SVG text: curves with bands, stick figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from posefuse.core.arrays import Array

WIDTH, HEIGHT = 340, 190
_LEFT, _RIGHT, _TOP, _BOTTOM = 40, 8, 26, 24
_MOST_POINTS = 500


@dataclass(frozen=True, eq=False)
class Curve:
    """One line of a chart: values (T,) with NaN for gaps, half-width of its band (T,), css class of its colour."""

    values: Array
    band: Array
    colour: str
    name: str


def chart(title: str, unit: str, t_s: Array, curves: Sequence[Curve], marks: Sequence[tuple[float, str]] = ()) -> str:
    """Curves over time as an <svg>; `marks` are (time, css class) of ticks on the time axis."""
    low, high = _range(curves)
    end = float(t_s[-1]) if len(t_s) and t_s[-1] > 0 else 1.0
    step = max(1, len(t_s) // _MOST_POINTS)

    def x_of(t: Array | float) -> Array:
        return np.asarray(_LEFT + (WIDTH - _LEFT - _RIGHT) * np.asarray(t) / end)

    def y_of(v: Array | float) -> Array:
        return np.asarray(HEIGHT - _BOTTOM - (HEIGHT - _TOP - _BOTTOM) * (np.asarray(v) - low) / (high - low))

    parts = [f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}">']
    parts.append(f'<text class="title" x="{_LEFT}" y="16">{escape(title)}</text>')
    for value in _ticks(low, high, 4):
        y = float(y_of(value))
        parts.append(
            f'<line class="{"zero" if value == 0 else "grid"}" x1="{_LEFT}" x2="{WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>'
        )
        parts.append(f'<text class="tick" x="{_LEFT - 5}" y="{y + 3:.1f}" text-anchor="end">{value:g}{unit}</text>')
    for value in _ticks(0.0, end, 5):
        parts.append(f'<text class="tick" x="{float(x_of(value)):.1f}" y="{HEIGHT - 8}" text-anchor="middle">{value:g} s</text>')
    for time_s, colour in marks:
        x = float(x_of(time_s))
        parts.append(
            f'<line class="mark {colour}" x1="{x:.1f}" x2="{x:.1f}" y1="{HEIGHT - _BOTTOM - 5}" y2="{HEIGHT - _BOTTOM}"/>'
        )
    for curve in curves:
        x = x_of(t_s[::step])
        middle, band = curve.values[::step], curve.band[::step]
        parts.extend(
            _bands(
                x,
                np.clip(y_of(middle - band), _TOP, HEIGHT - _BOTTOM),
                np.clip(y_of(middle + band), _TOP, HEIGHT - _BOTTOM),
                curve,
            )
        )
        parts.append(f'<path class="line {curve.colour}" d="{_path(x, y_of(middle))}"><title>{escape(curve.name)}</title></path>')
    parts.append("</svg>")
    return "".join(parts)


def stick_figures(points: Array, bones: Array, colours: Sequence[str], labels: Sequence[str], height: int = 190) -> str:
    """Figures side by side as an <svg>: points (F, K, 2), horizontal and up in metres; bones (B, 2); a css class per bone."""
    if not np.isfinite(points).any():
        return ""
    flat = points - np.nanmedian(points, axis=1, keepdims=True) * [1, 0]
    reach = float(np.nanmax(np.abs(flat[..., 0]))) + 0.05
    low, high = float(np.nanmin(flat[..., 1])), float(np.nanmax(flat[..., 1]))
    scale = (height - 26) / max(high - low, 0.5)
    cell = 2 * reach * scale
    parts = [f'<svg class="strip" viewBox="0 0 {cell * len(flat):.0f} {height}" role="img" aria-label="stick figures">']
    for i, figure in enumerate(flat):
        x = cell * (i + 0.5) + figure[:, 0] * scale
        y = height - 20 - (figure[:, 1] - low) * scale
        for (a, b), colour in zip(bones, colours, strict=True):
            if np.isfinite([x[a], x[b]]).all():
                parts.append(f'<line class="bone {colour}" x1="{x[a]:.1f}" y1="{y[a]:.1f}" x2="{x[b]:.1f}" y2="{y[b]:.1f}"/>')
        parts.append(
            f'<text class="tick" x="{cell * (i + 0.5):.1f}" y="{height - 4}" text-anchor="middle">{escape(labels[i])}</text>'
        )
    return "".join(parts) + "</svg>"


def _range(curves: Sequence[Curve]) -> tuple[float, float]:
    """Lowest and highest value drawn; bands count up to the height of the curves themselves, the rest is cut off."""
    known = [np.isfinite(curve.values) for curve in curves]
    if not any(mask.any() for mask in known):
        return -1.0, 1.0
    values = np.concatenate([curve.values[mask] for curve, mask in zip(curves, known, strict=True)])
    band = np.concatenate([np.nan_to_num(curve.band[mask]) for curve, mask in zip(curves, known, strict=True)])
    room = np.minimum(band, max(2.0, 0.6 * float(np.ptp(values))))
    return float((values - room).min()) - 1.0, float((values + room).max()) + 1.0


def _ticks(low: float, high: float, about: int) -> Array:
    raw = (high - low) / about
    size = 10 ** np.floor(np.log10(raw))
    step = size * min((1, 2, 5, 10), key=lambda m: abs(m * size - raw))
    return np.round(np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step, 6) + 0.0


def _runs(known: Array) -> list[slice]:
    """Stretches without gaps."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(int), [0]])))
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _path(x: Array, y: Array) -> str:
    return " ".join(
        "M" + " L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x[run], y[run], strict=True)) for run in _runs(np.isfinite(y))
    )


def _bands(x: Array, low: Array, high: Array, curve: Curve) -> list[str]:
    parts = []
    for run in _runs(np.isfinite(low) & np.isfinite(high)):
        outline = [*zip(x[run], high[run], strict=True), *zip(x[run][::-1], low[run][::-1], strict=True)]
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in outline)
        parts.append(f'<polygon class="band {curve.colour}" points="{points}"/>')
    return parts
