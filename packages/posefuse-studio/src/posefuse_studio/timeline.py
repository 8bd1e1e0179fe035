"""Curves over the time of a recording with gait events, stretches that are left out, and a cursor that is moved."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from nicegui import ui

from posefuse.core.arrays import Array
from posefuse.core.palette import LEFT, MIDDLE, RIGHT
from posefuse.pipeline.edits import Exclusion

COLOURS = {"left": LEFT.on_light, "right": RIGHT.on_light, "mid": MIDDLE.on_light}
_MOST_POINTS = 600
# of the curves within the element; the style has the same
_GRID = {"left": 52, "right": 12, "top": 30, "bottom": 30}
_GREY, _FONT = "#78909c", {"color": "#78909c", "fontSize": 13}
_ABOUT = "Timeline: arrows go frame by frame, page keys by a second, space plays and pauses"
# the place of the pointer as a share of the width, while a button is pressed
_POINTED = "(event) => event.buttons && emit(event.offsetX / event.currentTarget.clientWidth)"


@dataclass(frozen=True, eq=False)
class Curve:
    """Values (T,) with a name; `side`: ``left``, ``right`` or ``mid``, which gives its colour."""

    name: str
    values: Array
    side: str = "mid"


class CurveTimeline:
    """The element.

    Args:
        begin_s, end_s: session seconds. seek: goes to a time. keys: what keys do while it has the focus, by name.
    """

    def __init__(
        self, begin_s: float, end_s: float, seek: Callable[[float], object], keys: Mapping[str, Callable[[], object]]
    ) -> None:
        self._begin_s, self._end_s = begin_s, max(end_s, begin_s + 1e-3)
        with ui.element("div").classes("pf-timeline-frame"), ui.element("div").classes("pf-timeline") as frame:
            self._chart = ui.echart({})
            with ui.element("div").classes("pf-timeline-over") as over:
                self._bands = ui.element("div")
                self._cursor = ui.element("div").classes("pf-cursor")
        for pressed in ("mousedown", "mousemove"):
            over.on(pressed, lambda event: seek(self.t_s(float(event.args))), js_handler=_POINTED, throttle=0.05)
        frame.props(f'tabindex=0 role="slider" aria-label="{_ABOUT}" aria-valuemin={begin_s:.3f} aria-valuemax={end_s:.3f}')
        for key, act in keys.items():
            frame.on(f"keydown.{key}.prevent", act)
        self._frame = frame

    def t_s(self, share: float) -> float:
        """The time at a share of the width, within the recording."""
        return self._begin_s + min(max(share, 0.0), 1.0) * (self._end_s - self._begin_s)

    def share(self, t_s: float) -> float:
        """The other way round."""
        return min(max((t_s - self._begin_s) / (self._end_s - self._begin_s), 0.0), 1.0)

    def show(self, t_s: Array, curves: Sequence[Curve], strikes: Mapping[str, Array], unit: str, empty: str = "") -> None:
        """Draw curves and foot strikes; see `chart_options`."""
        self._chart.options.clear()
        self._chart.options.update(chart_options((self._begin_s, self._end_s), t_s, curves, strikes, unit, empty))
        self._chart.update()

    def move(self, t_s: float) -> None:
        """Place the cursor."""
        self._cursor.style(f"left: {self.share(t_s):.3%}")
        self._frame.props(f"aria-valuenow={t_s}")

    def mark(self, exclusions: Sequence[Exclusion], marked_s: tuple[float, float] | None) -> None:
        """Show excluded ranges, and the one that is being marked."""
        bands = [(one.start_s, one.end_s, "pf-excluded", one.camera or "all cameras") for one in exclusions]
        bands += [(*marked_s, "pf-marked", "")] if marked_s is not None else []
        self._bands.clear()
        with self._bands:
            for start_s, end_s, kind, text in bands:
                left, right = self.share(start_s), self.share(end_s)
                ui.label(text).classes(f"pf-band {kind}").style(f"left: {left:.3%}; width: {right - left:.3%}")


def chart_options(
    span_s: tuple[float, float], t_s: Array, curves: Sequence[Curve], strikes: Mapping[str, Array], unit: str, empty: str = ""
) -> dict[str, Any]:
    """Curves over time with gaps where values are missing, foot strikes as ticks at the bottom.

    Args:
        span_s: from, to. t_s: (T,) session seconds. strikes: by side, session seconds. empty: the text where there is no curve.
    """
    known = np.concatenate([one.values[np.isfinite(one.values)] for one in curves] or [np.zeros(0)])
    low, high = (float(known.min()), float(known.max())) if len(known) else (-1.0, 1.0)
    room = 0.08 * (high - low) + 1e-3
    # of a long recording every n-th value
    every = max(1, len(t_s) // _MOST_POINTS)
    lines: list[dict[str, Any]] = [
        {"type": "line", "name": one.name, "showSymbol": False, "color": COLOURS[one.side],
         "data": [[t, value if np.isfinite(value) else None]
                  for t, value in zip(t_s[::every].tolist(), one.values[::every].tolist(), strict=True)]}
        for one in curves
    ]  # fmt: skip
    ticks = [
        {"type": "scatter", "symbol": "rect", "symbolSize": [3, 14], "color": COLOURS[side],
         "data": [[t, low - room] for t in times.tolist()]}
        for side, times in strikes.items()
    ]  # fmt: skip
    axis = {"axisLabel": _FONT, "axisLine": {"show": False}, "axisTick": {"show": False}}
    faint = {"lineStyle": {"color": _GREY, "opacity": 0.3}}
    return {
        "animation": False, "grid": _GRID, "series": [*lines, *ticks],
        "title": {"text": "" if curves else empty, "left": _GRID["left"], "textStyle": _FONT},
        "legend": {"left": _GRID["left"], "top": 0, "data": [one.name for one in curves], "textStyle": _FONT},
        "xAxis": {"type": "value", "min": span_s[0], "max": span_s[1], **axis, "splitLine": {"show": False},
                  "axisLabel": {**_FONT, "formatter": "{value} s", "showMinLabel": False, "showMaxLabel": False}},
        "yAxis": {"type": "value", "min": low - room, "max": high + room, **axis, "show": bool(curves), "splitLine": faint,
                  "axisLabel": {**_FONT, "formatter": f"{{value}}{unit}", "showMinLabel": False, "showMaxLabel": False}},
    }  # fmt: skip
