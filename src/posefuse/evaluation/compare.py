"""Two recordings of the same movement by different systems: aligned in time and space, then compared joint by joint."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.formats.page import Line, Page, Plot, Plots, write_page
from posefuse.foundation.output_folder import output_folder
from posefuse.foundation.parsing import plain
from posefuse.foundation.summary import Block, Facts, Heading, Note, Table

from .metrics import JointErrors, drift, summary

PAGE_FILE, FIGURES_FILE = "compare.html", "compare.json"
_LEAST_TIME_STEPS = 5
_SPEED_HZ = 60.0
# offsets that far from the best one of whole samples are tried at the end
_FINE_S = 2 / _SPEED_HZ
# of the values of a shift, this share must be known in both
_LEAST_KNOWN = 0.1
_GAP_S = 0.25
# offsets in time, a gait cycle or so apart, that are tried in full
_MOST_OFFSETS = 16
# distances of the demo tracked twice, at offsets half a round apart, differ by 3 % by chance
_AS_WELL = 1.1


@dataclass(frozen=True, eq=False)
class Tracks:
    """Named points over time, of one person.

    Attributes:
        name: of the recording, for people. points: K names. t_s: (T,) seconds, increasing. xyz_m: (T, K, 3); NaN where missing.
        warning: why they are not to be trusted; empty otherwise. of_several: whether the recording has other people, too.
    """

    name: str
    points: tuple[str, ...]
    t_s: Array
    xyz_m: Array
    warning: str = ""
    of_several: bool = False

    def at(self, t_s: Array) -> Array:
        """(n, K, 3) at other times, linearly between time steps at most a quarter of a second apart; NaN elsewhere."""
        out = np.full((len(t_s), len(self.points), 3), np.nan)
        for k in range(len(self.points)):
            known = np.isfinite(self.xyz_m[:, k]).all(axis=-1)
            times, xyz = self.t_s[known], self.xyz_m[known, k]
            if len(times) < 2:
                continue
            later = np.clip(np.searchsorted(times, t_s), 1, len(times) - 1)
            near = (times[later] - times[later - 1] < _GAP_S) & (t_s >= times[0] - 1e-9) & (t_s <= times[-1] + 1e-9)
            for axis in range(3):
                out[near, k, axis] = np.interp(t_s[near], times, xyz[:, axis])
        return out

    def at_times(self, t_s: Array) -> Tracks:
        """The tracks at other times, see `at`."""
        return replace(self, t_s=t_s, xyz_m=self.at(t_s))

    def only(self, points: Sequence[str]) -> Tracks:
        """The given points, in that order."""
        return Tracks(self.name, tuple(points), self.t_s, self.xyz_m[:, [self.points.index(p) for p in points]])


@dataclass(frozen=True, eq=False)
class Alignment:
    """How b was brought onto a: xyz_a = scale * rotation @ xyz_b + shift_m, t_a = t_b + offset_s.

    Attributes:
        rotation: (3, 3). shift_m: (3,). residual_m: rms distance after it.
    """

    offset_s: float
    rotation: Array
    shift_m: Array
    scale: float
    residual_m: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison:
    """What two recordings differ by.

    Attributes:
        alignment: of b onto a. points: those in both. t_s: (T,) times of a. a_m, b_m: (T, K, 3), b aligned.
        errors: distances per point.
        walked_m: (T,) way of the middle of a. apart_m: (T,) level distance of the middles. drift_mm_per_m: its slope,
            NaN where the person walks less than half a metre.
        a, b: what was compared, as it was. inputs: files and folders that it was read from. notes: why nothing was aligned.
    """

    a: Tracks
    b: Tracks
    alignment: Alignment
    points: tuple[str, ...]
    t_s: Array
    a_m: Array
    b_m: Array
    errors: JointErrors
    walked_m: Array
    apart_m: Array
    drift_mm_per_m: float
    inputs: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def doubt(self) -> str:
        """Why the offset in time may be wrong; empty where nothing speaks against it.

        Offsets at which less than half of the shorter one has a counterpart are not looked for, see `_speed_costs`.
        """
        a_s, b_s = self.a.t_s, self.b.t_s
        common_s = max(0.0, float(min(a_s[-1], b_s[-1]) - max(a_s[0], b_s[0])))
        half_s = min(float(np.ptp(a_s)), float(np.ptp(b_s))) / 2
        if common_s >= half_s or abs(self.alignment.offset_s) <= _FINE_S:
            return ""
        return (
            f"by their own times {self.a.name} and {self.b.name} have {common_s:.1f} s in common, too little to look for an "
            "offset there: if both have the times of one clock, add `align_time=False`"
        )

    @property
    def figures(self) -> dict[str, Any]:
        """The comparison as plain values, point by point."""
        errors = self.errors
        return {
            "offset_s": self.alignment.offset_s,
            "rotation": self.alignment.rotation.tolist(),
            "shift_m": self.alignment.shift_m.tolist(),
            "scale": self.alignment.scale,
            "residual_mm": 1000 * self.alignment.residual_m,
            "mean_mm": errors.mpjpe_mm,
            "drift_mm_per_m": self.drift_mm_per_m,
            "walked_m": float(self.walked_m[-1]),
            "points": {
                point: {name: float(getattr(errors, name)[k]) for name in ("mean_mm", "sd_mm", "median_mm", "p95_mm", "found")}
                for k, point in enumerate(self.points)
            },
        }

    def summary(self) -> list[Block]:
        """The alignment and the distances, for people."""
        turn = np.degrees(np.arccos(np.clip((np.trace(self.alignment.rotation) - 1) / 2, -1, 1)))
        slope = f"{self.drift_mm_per_m:z.1f} mm per m" if np.isfinite(self.drift_mm_per_m) else "not determined"
        facts = {
            "offset in time": f"{1000 * self.alignment.offset_s:z.1f} ms",
            "turned by": f"{turn:.2f} deg",
            "moved by": f"{np.linalg.norm(self.alignment.shift_m):.3f} m",
            "scale": f"{self.alignment.scale:.4f}",
            "mean distance": f"{self.errors.mpjpe_mm:.1f} mm over {len(self.points)} points",
            "drift": f"{slope} over {self.walked_m[-1]:.1f} m walked",
        }
        rows = [
            [point.replace("_", " "), *list(row.values())[:-1], f"{row['found']:.0%}"]
            for point, row in self.figures["points"].items()
        ]
        return [
            *map(Note, self.notes),
            *(Note(line, warning=True) for line in (self.doubt, self.a.warning, self.b.warning) if line),
            Note(f"{self.b.name} is aligned to {self.a.name}"),
            Heading("Alignment"),
            Facts(facts),
            Heading("Distances, mm"),
            Table(["point", "mean", "sd", "median", "p95", "share compared"], rows),
        ]

    def save(self, folder: str | Path) -> Path:
        """Write the page and the figures into a folder, in place of an unchanged earlier comparison; returns the page.

        Raises:
            InputError: the folder holds anything else, or overlaps an input.
        """
        # its own, unchanged, can be made again at any time: replaced without being asked
        with output_folder(Path(folder), command="compare", inputs=self.inputs, replace=True) as place:
            (place.folder / FIGURES_FILE).write_text(json.dumps(plain(self.figures), indent=2) + "\n", encoding="utf-8")
            write_page(place.folder / PAGE_FILE, comparison_page(self))
        return Path(folder) / PAGE_FILE


def compare(
    a: Tracks, b: Tracks, time: bool = True, space: bool = True, scale: bool = False, start_s: float | None = None
) -> Comparison:
    """Bring b onto a and measure what is left.

    Args:
        a, b: recordings with at least three points in common (by name).
        time: find b's offset in time, to fractions of a frame.
        space: find the rigid motion that brings b onto a; with `scale` also its scale.
        start_s: align in space by the first seconds only, so that a drift later on shows.

    Raises:
        InputError: too little in common.
    """
    points = [p for p in dict.fromkeys(a.points) if p in b.points]
    if (len(points) < 3 and space) or not points:
        raise InputError(
            f"{a.name} and {b.name} have {len(points)} points in common, too few to align; "
            f"{a.name} has: {choices(a.points)}; {b.name} has: {choices(b.points)}"
        )
    given = a, b
    a, b = a.only(points), b.only(points)
    offset = _offset(a, b, space, scale) if time else 0.0
    moved = b.at(a.t_s - offset)
    both = np.asarray(np.isfinite(a.xyz_m).all(axis=-1) & np.isfinite(moved).all(axis=-1))
    if both.any(axis=1).sum() < _LEAST_TIME_STEPS:
        raise InputError(f"{a.name} and {b.name}: fewer than {_LEAST_TIME_STEPS} time steps in common after alignment in time")
    early = moved if start_s is None else np.where((a.t_s <= a.t_s[0] + start_s)[:, None, None], moved, np.nan)
    (rotation, shift, factor), _ = _fitted(a.xyz_m, early, space, scale)
    onto = factor * moved @ rotation.T + shift
    distance = np.linalg.norm(onto - a.xyz_m, axis=-1)
    alignment = Alignment(offset, rotation, shift, factor, float(np.sqrt(np.nanmean(distance[both] ** 2))))
    (middle, other), way = _middles(a.xyz_m, onto), _way(a)
    walked_m, apart_m, slope = drift(way, way + other - middle)
    return Comparison(
        a=given[0],
        b=given[1],
        alignment=alignment,
        points=tuple(points),
        t_s=a.t_s,
        a_m=a.xyz_m,
        b_m=onto,
        errors=summary(points, 1000 * distance),
        walked_m=walked_m,
        apart_m=apart_m,
        drift_mm_per_m=slope,
    )


def _way(tracks: Tracks) -> Array:
    """(T, 3) way of the middle of points that come and go: it moves as they do, and not because one of them is missing."""
    whole = np.full_like(tracks.xyz_m, np.nan)
    for k, xyz in enumerate(tracks.xyz_m.swapaxes(0, 1)):
        known = np.isfinite(xyz).all(axis=-1)
        for axis in range(3 if known.any() else 0):
            whole[:, k, axis] = np.interp(tracks.t_s, tracks.t_s[known], xyz[known, axis], np.nan, np.nan)
    steps = np.nan_to_num(middle_of(np.diff(whole, axis=0)))
    return np.asarray(np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]))


def comparison_page(found: Comparison) -> Page:
    """Alignment, distances, drift and every point over time."""
    a, b = found.a, found.b
    t_s = found.t_s - found.t_s[0]
    middles = _middles(found.a_m, found.b_m)
    apart = Line("apart", found.walked_m, 1000 * found.apart_m)
    paths = [Line(name, m[:, 0], m[:, 1]) for name, m in zip((a.name, b.name), middles, strict=True)]
    points = [
        Plot(
            f"{point.replace('_', ' ')}, {axis}",
            [Line(a.name, t_s, found.a_m[:, k, i]), Line(b.name, t_s, found.b_m[:, k, i])],
            x_label="s", y_label="m",
        )
        for k, point in enumerate(found.points)
        for i, axis in enumerate("xyz")
    ]  # fmt: skip
    return Page(
        f"{b.name} compared with {a.name}",
        [
            *found.summary(),
            Heading("Drift", "Horizontal distance between the means of all points."),
            Plots(
                [
                    Plot("Along the path", [apart], x_label="distance walked, m", y_label="mm", from_zero=True),
                    Plot("From above", paths, x_label="x, m", y_label="y, m", equal=True),
                ]
            ),
            Heading("Points over time"),
            Plots(points, small=True),
        ],
    )


def similarity(moving: Array, fixed: Array, scale: bool) -> tuple[Array, Array, float]:
    """Rotation (3, 3), shift (3,) and scale with least squares fixed = scale * rotation @ moving + shift (Umeyama 1991)."""
    centre_m, centre_f = moving.mean(axis=0), fixed.mean(axis=0)
    m, f = moving - centre_m, fixed - centre_f
    left, values, right = np.linalg.svd(f.T @ m)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ sign @ right
    factor = float((values * np.diag(sign)).sum() / (m**2).sum()) if scale else 1.0
    return rotation, centre_f - factor * rotation @ centre_m, factor


def _fitted(a_m: Array, b_m: Array, space: bool, scale: bool) -> tuple[tuple[Array, Array, float], float]:
    """The similarity of b (T, K, 3) onto a where both are, and the mean distance it leaves; inf where too little is."""
    both = np.asarray(np.isfinite(a_m).all(axis=-1) & np.isfinite(b_m).all(axis=-1))
    onto = (np.eye(3), np.zeros(3), 1.0)
    if both.any(axis=1).sum() < _LEAST_TIME_STEPS:
        return onto, np.inf
    if space:
        onto = similarity(b_m[both], a_m[both], scale)
    left = onto[2] * b_m[both] @ onto[0].T + onto[1] - a_m[both]
    # not rms: between two samples a false jump is halved, so the squares of a few such jumps would draw the offset there
    return onto, float(np.linalg.norm(left, axis=-1).mean())


def _offset(a: Tracks, b: Tracks, space: bool, scale: bool) -> float:
    """Seconds to add to b's times: of the offsets at which speeds agree well the one at which positions agree best.

    Speeds do not depend on where either system's origin is, but repeat from one gait cycle to the next: positions decide. They
    repeat, too, where a circle is walked at one pace: recordings whose own times fit as well have one clock.
    """
    lag_s, cost = _speed_costs(a, b)
    tried = [float(lag_s[i]) for i in _lowest(cost)]
    if not space:
        # one world frame is mostly one clock, too: parts of one session may have little time in common
        tried.append(0.0)

    def misfit(offset: float) -> float:
        return _fitted(a.xyz_m, b.at(a.t_s - offset), space, scale)[1]

    coarse = min(tried, key=misfit, default=0.0)
    if not np.isfinite(misfit(coarse)):
        raise InputError(
            f"{a.name} and {b.name}: nothing in common over time: too few points are known in both to find their offset"
        )
    own = min((offset for offset in tried if abs(offset) <= _FINE_S), key=misfit, default=coarse)
    if misfit(own) <= _AS_WELL * misfit(coarse):
        coarse = own
    bounds = (coarse - _FINE_S, coarse + _FINE_S)
    fine = minimize_scalar(misfit, bounds=bounds, method="bounded", options={"xatol": 1e-4})
    return float(fine.x)


def _lowest(cost: Array) -> list[int]:
    """Places of the lowest local minima, lowest first; NaN is no minimum."""
    filled = np.where(np.isfinite(cost), cost, np.inf)
    padded = np.concatenate([[np.inf], filled, [np.inf]])
    minima = np.flatnonzero((filled <= padded[:-2]) & (filled <= padded[2:]) & np.isfinite(filled))
    return [int(i) for i in minima[np.argsort(filled[minima], kind="stable")][:_MOST_OFFSETS]]


def _speed_costs(a: Tracks, b: Tracks) -> tuple[Array, Array]:
    """(L,) offsets in s that overlap by half of the shorter one, and how much speeds differ there; NaN where few are known.

    The mean squared difference of the roots of speeds, of all offsets at once by the Fourier transform. Roots, so that a false
    jump counts by its size, not by the square of it.
    """
    # not with the other imports: every command would take a third of a second for it
    from scipy.signal import correlate, correlation_lags

    times = [np.arange(one.t_s[0], one.t_s[-1], 1 / _SPEED_HZ) for one in (a, b)]
    # of a single time step there is no speed
    if not all(map(len, times)):
        return np.zeros(0), np.zeros(0)
    lags = correlation_lags(*map(len, times))
    apart, pairs = np.zeros((2, len(lags)))
    for point in a.points:
        roots = [np.sqrt(_speed(one.only([point]).at(t)[:, 0])) for one, t in zip((a, b), times, strict=True)]
        (one, one_known), (two, two_known) = ((np.nan_to_num(root), np.isfinite(root) * 1.0) for root in roots)
        apart += correlate(one**2, two_known) + correlate(one_known, two**2) - 2 * correlate(one, two)
        pairs += np.rint(correlate(one_known, two_known))
    common = np.minimum(len(times[0]), len(times[1]) + lags) - np.maximum(0, lags)
    overlapping, enough = common >= min(map(len, times)) // 2, pairs > _LEAST_KNOWN * len(a.points) * common
    cost = np.where(enough, np.maximum(apart, 0.0) / np.maximum(pairs, 1), np.nan)
    return lags[overlapping] / _SPEED_HZ + times[0][0] - times[1][0], cost[overlapping]


def _speed(xyz: Array) -> Array:
    """(n,) speed in m/s over a few samples of (n, 3)."""
    span = 4
    moved = np.full(len(xyz), np.nan)
    moved[span // 2 : -span // 2] = np.linalg.norm(xyz[span:] - xyz[:-span], axis=-1) * _SPEED_HZ / span
    return moved


def middle_of(xyz: Array) -> Array:
    """(T, 3) mean of the points (T, K, 3) that are there; NaN where none is."""
    count = np.isfinite(xyz).all(axis=-1).sum(axis=1)[:, None]
    return np.asarray(np.nansum(xyz, axis=1) / np.where(count > 0, count, np.nan))


def _middles(a: Array, b: Array) -> tuple[Array, Array]:
    """(T, 3) each: means of the points (T, K, 3) that are in both."""
    both = np.isfinite(a) & np.isfinite(b)
    return middle_of(np.where(both, a, np.nan)), middle_of(np.where(both, b, np.nan))
