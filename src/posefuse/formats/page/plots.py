"""Plots of a page: series over a common x, with the axes they need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar

import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array

# Numbers of a page, as finely as a screen shows them.

# parts of the range of the values: finer than a screen shows, and coarse enough that noise is not stored
FINE, COARSE = 10_000, 2_000


def page_numbers(values: Array, parts: int) -> list[float | None]:
    """Values (n,) rounded to a power of ten that is at most 1 / `parts` of their range; what is not finite becomes null."""
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if len(known) else 0.0
    span = span or (float(np.abs(known).max()) if len(known) else 0.0) or 1.0
    return with_decimals(values, int(min(12, np.ceil(np.log10(parts) - np.log10(span)))))


def with_decimals(values: Array, decimals: int) -> list[float | None]:
    """Values (n,) with so many decimals; what is not finite becomes null."""
    return [value if np.isfinite(value) else None for value in np.round(values, decimals).tolist()]


class Arrays:
    """Arrays of a page, each stored once; series name them by their number."""

    def __init__(self) -> None:
        self.content: list[list[float | None]] = []
        self._known: dict[tuple[bytes, int], int] = {}

    def add(self, values: Array, parts: int = FINE) -> int:
        """The number of an array (n,), kept to 1 / `parts` of its range."""
        values = np.ascontiguousarray(values, float)
        key = values.tobytes(), parts
        if key not in self._known:
            self._known[key] = len(self.content)
            self.content.append(page_numbers(values, parts))
        return self._known[key]


COLOURS = ("c0", "c1", "c2", "c3", "c4", "c5", "left", "right", "mid", "ink", "soft", "bad")
_CYCLE = 6
_MOST_POINTS = 3600
# a band is background: as many as a screen shows
_MOST_BAND_POINTS = 900
_ROOM = 0.04
# a band may widen the y axis by this share of the range of the lines, on each side
_BAND_ROOM = 1.0


class _Series:
    """Checks what all series share; `of` maps the arrays of a series to their names in the page's data."""

    type: ClassVar[str]
    of: ClassVar[tuple[str, ...]]
    colour: str | None

    def __post_init__(self) -> None:
        shapes = {name: np.shape(getattr(self, name)) for name in self.of}
        if len(set(shapes.values())) > 1 or any(len(shape) != 1 for shape in shapes.values()):
            raise InputError(f"{self.type}: expected arrays of one length, got {shapes}")
        if self.colour is not None and self.colour not in COLOURS:
            raise InputError(f"{self.type}: unknown colour {self.colour!r}; there are: {', '.join(COLOURS)}")


@dataclass(frozen=True, eq=False)
class Line(_Series):
    """A line through x and y (n,), NaN for gaps.

    `colour` is one of `COLOURS`, None takes the next of the plot. A `faint` line is background: thin and not in the legend.
    """

    name: str
    x: Array
    y: Array
    _: KW_ONLY
    colour: str | None = None
    faint: bool = False
    type: ClassVar[str] = "line"
    of: ClassVar[tuple[str, ...]] = ("x", "y")


@dataclass(frozen=True, eq=False)
class _Between(_Series):
    """From low to high (n,) at x (n,), NaN for gaps."""

    name: str
    x: Array
    low: Array
    high: Array
    _: KW_ONLY
    colour: str | None = None
    of: ClassVar[tuple[str, ...]] = ("x", "low", "high")


class Band(_Between):
    """The area between low and high over x."""

    type: ClassVar[str] = "band"


@dataclass(frozen=True, eq=False)
class Dots(_Series):
    """Points at x and y (n,), with texts next to them if there are `labels`."""

    name: str
    x: Array
    y: Array
    _: KW_ONLY
    colour: str | None = None
    labels: Sequence[str] = ()
    type: ClassVar[str] = "dots"
    of: ClassVar[tuple[str, ...]] = ("x", "y")


class Spikes(_Between):
    """Upright strokes from low to high at x."""

    type: ClassVar[str] = "spikes"


@dataclass(frozen=True, eq=False)
class Ticks(_Series):
    """Short strokes on the x axis at x (n,): events."""

    name: str
    x: Array
    _: KW_ONLY
    colour: str | None = None
    type: ClassVar[str] = "ticks"
    of: ClassVar[tuple[str, ...]] = ("x",)


Series = Line | Band | Dots | Spikes | Ticks


@dataclass(frozen=True, eq=False)
class Plot:
    """Series in one pair of axes.

    Attributes:
        x_label, y_label: what the axes show, with units. equal: one scale on both axes; from_zero: y begins at 0.
        window: x least and greatest, y least and greatest, where plots are compared.
        legend: name the series above the plot, if there are several.
    """

    title: str
    series: Sequence[Series]
    _: KW_ONLY
    x_label: str
    y_label: str
    equal: bool = False
    from_zero: bool = False
    window: tuple[float, float, float, float] | None = None
    legend: bool = True


@dataclass(frozen=True, eq=False)
class Plots:
    """Plots side by side: in two columns or, if they are small, in three; in one on a phone."""

    plots: Sequence[Plot]
    _: KW_ONLY
    small: bool = False
    kind: ClassVar[str] = "plots"


def plot_content(plot: Plot, arrays: Arrays) -> dict[str, Any]:
    """A plot as the page's script reads it; its arrays go into `arrays`."""
    step = max(1, *(-(-len(getattr(one, "x", ())) // _MOST_POINTS) for one in plot.series), 1)
    return {
        "title": plot.title,
        "x": plot.x_label + (f" (every {step}th point drawn)" if step > 1 else ""),
        "y": plot.y_label,
        "equal": plot.equal,
        "legend": plot.legend and sum(map(_in_legend, plot.series)) > 1,
        "ranges": _ranges(plot),
        "series": [_series_content(one, colour, step, arrays) for one, colour in zip(plot.series, _colours(plot), strict=True)],
    }


def _in_legend(one: Series) -> bool:
    return bool(getattr(one, "name", "")) and not isinstance(one, Band) and not (isinstance(one, Line) and one.faint)


def _colours(plot: Plot) -> list[str]:
    free = (f"c{i % _CYCLE}" for i in range(len(plot.series)))
    return [getattr(one, "colour", None) or next(free) for one in plot.series]


def _series_content(one: Series, colour: str, step: int, arrays: Arrays) -> dict[str, Any]:
    content: dict[str, Any] = {"type": one.type, "name": one.name, "colour": colour}
    if isinstance(one, Band):
        step = max(step, -(-len(one.x) // _MOST_BAND_POINTS))
    kept = {name: np.asarray(getattr(one, name), float)[::step] for name in one.of}
    if isinstance(one, Band):
        # smoother than the upper edge, so shorter
        kept["width"] = kept.pop("high") - kept["low"]
    rough = isinstance(one, Band) or (isinstance(one, Line) and one.faint)
    content |= {name: arrays.add(values, COARSE if rough and name != "x" else FINE) for name, values in kept.items()}
    if isinstance(one, Line) and one.faint:
        content["faint"] = True
    if isinstance(one, Dots) and one.labels:
        content["labels"] = list(one.labels)[::step]
    return content


def _ranges(plot: Plot) -> list[list[float] | None]:
    """Least and greatest x and y shown at first; None leaves the choice to the script."""
    if plot.window is not None:
        return [list(plot.window[:2]), list(plot.window[2:])]
    bands = [one for one in plot.series if isinstance(one, Band)]
    lines = [np.asarray(one.y, float) for one in plot.series if isinstance(one, Line | Dots)]
    low, high = _extent(lines)
    if not (bands or plot.from_zero) or not low <= high:
        return [None, None]
    if bands:
        reach = _BAND_ROOM * ((high - low) or 1.0)
        least, most = _extent([np.asarray(edge, float) for one in bands for edge in (one.low, one.high)])
        low, high = max(least, low - reach) if least < low else low, min(most, high + reach) if most > high else high
    room = _ROOM * (high - low) or 1.0
    return [None, [0.0 if plot.from_zero else low - room, high + room]]


def _extent(columns: Sequence[Array]) -> tuple[float, float]:
    known = [column[np.isfinite(column)] for column in columns]
    known = [column for column in known if len(column)]
    if not known:
        return float("inf"), float("-inf")
    return min(float(column.min()) for column in known), max(float(column.max()) for column in known)
