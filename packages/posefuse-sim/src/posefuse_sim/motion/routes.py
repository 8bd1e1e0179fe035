"""Ways along the floor, by distance walked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, CubicSpline

from posefuse.core import ConfigError
from posefuse.core.arrays import Array

from .settings import BackForthPath, CirclePath, LinePath, RandomPath, WalkPath

_STEP_M = 0.005
_SHORTEST_M = 1.0
# of the half circle in which a person who walks back and forth turns round; slower there
_TURN_RADIUS_M = 0.4
# half of the distance over which a stop, a start or a reversal along a line is rounded off
_ROUNDING_M = 0.15
_FASTEST_SIDE_MPS2 = 2.5
_RANDOM_TRIES = 400
_TIGHTEST_RANDOM_M = 0.4
_MARGIN_M = 0.15
_ROUNDS, _ROUND_POINTS, _CURVE_SAMPLES = 4, 8, 8001
_EIGHT_WIDTH, _LOOSE = 0.6, 0.08


@dataclass(frozen=True, eq=False, kw_only=True)
class Route:
    """A way over the floor.

    Attributes:
        place: distance walked (T,) -> x, y (T, 2). Where it loops, any distance, before 0 as well.
        heading: distance -> direction of travel (T,) in radians, continuous.
        curvature: distance -> 1/m (T,), positive to the left.
        length_m: of one lap, or to the end. loops: whether it continues.
        facing_rad: the fixed direction the person faces; None faces the direction of travel.
        ends_m: distances in one lap where the person slows down to turn back or stop.
    """

    place: Callable[[Array], Array]
    heading: Callable[[Array], Array]
    curvature: Callable[[Array], Array]
    length_m: float
    loops: bool = True
    facing_rad: float | None = None
    ends_m: tuple[float, ...] = ()


def straight_on() -> Route:
    """For ever along world +X: the gait laboratory."""
    return Route(
        place=lambda u: np.stack([u, np.zeros_like(u)], axis=-1), heading=np.zeros_like, curvature=np.zeros_like, length_m=1.0
    )


def route(path: WalkPath, speed_mps: float, seed: int) -> Route:
    """The way a path's settings describe; raises ConfigError for one that cannot be walked at this speed."""
    match path:
        case CirclePath():
            return _circle(path, speed_mps)
        case LinePath():
            return _straight(path)
        case BackForthPath():
            return _straight(path) if path.facing == "sideways" else _turning(path)
        case RandomPath():
            return _random(path, np.random.default_rng(seed))


def _circle(path: CirclePath, speed_mps: float) -> Route:
    fastest = float(np.sqrt(_FASTEST_SIDE_MPS2 * path.radius_m))
    if speed_mps > fastest:
        raise ConfigError(
            f"speed_mps: expected at most {fastest:.2f} m/s on a circle of radius_m {path.radius_m}, got {speed_mps}"
        )
    sense = -1.0 if path.clockwise else 1.0
    start, centre, radius = np.deg2rad(path.start_deg), np.array(path.centre_m), path.radius_m

    def place(u: Array) -> Array:
        angle = start + sense * u / radius
        return centre + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    return Route(
        place=place,
        heading=lambda u: start + sense * (u / radius + np.pi / 2),
        curvature=lambda u: np.full_like(u, sense / radius),
        length_m=2 * np.pi * radius,
    )


def _ends(path: LinePath | BackForthPath) -> tuple[Array, Array, float]:
    start, end = np.array(path.start_m), np.array(path.end_m)
    length = float(np.linalg.norm(end - start))
    if length < _SHORTEST_M:
        raise ConfigError(f"end_m: expected at least {_SHORTEST_M} m from start_m, got {length:.2f} m")
    return start, (end - start) / length, length


def _straight(path: LinePath | BackForthPath) -> Route:
    """To the end of a line; of a path there and back again by side-steps, to the left of the way there."""
    start, ahead, length = _ends(path)
    far, back = length + 2 * _ROUNDING_M, isinstance(path, BackForthPath)
    angle = float(np.arctan2(ahead[1], ahead[0]))

    def place(u: Array) -> Array:
        lap = np.mod(u, 2 * far)
        there = np.minimum(lap, 2 * far - lap) if back else np.clip(u, 0.0, far)
        return np.asarray(start + _line_progress(there, far, length)[:, None] * ahead)

    return Route(
        place=place,
        heading=lambda u: np.full_like(u, angle),
        curvature=np.zeros_like,
        length_m=2 * far if back else far,
        loops=back,
        facing_rad=angle + np.pi / 2 if back else None,
        ends_m=(0.0, far),
    )


def _eased(u: Array) -> Array:
    """Progress along a line after `u` of travel from a standstill: its slope grows from 0 to 1 over two roundings."""
    return np.where(u < 2 * _ROUNDING_M, u**2 / (4 * _ROUNDING_M), u - _ROUNDING_M)


def _line_progress(u: Array, far: float, length: float) -> Array:
    return np.where(u < far / 2, _eased(u), length - _eased(far - u))


def _turning(path: BackForthPath) -> Route:
    start, ahead, length = _ends(path)
    angle = float(np.arctan2(ahead[1], ahead[0]))
    # curvature rises and falls as a raised cosine: half a turn over this distance, tightest at this radius
    arc = 2 * np.pi * _TURN_RADIUS_M
    lap = 2 * (length + arc)
    grid = np.linspace(0.0, lap, 2 * max(200, round(lap / _STEP_M / 2)) + 1)

    def curvature(u: Array) -> Array:
        in_turn = np.mod(u, lap / 2) - length
        return np.where(in_turn > 0, np.pi / arc * (1 - np.cos(2 * np.pi * in_turn / arc)), 0.0)

    def turned(u: Array) -> Array:
        halves = np.floor(u / (lap / 2))
        part = np.clip((u - halves * lap / 2 - length) / arc, 0.0, 1.0)
        return angle + np.pi * (halves + part - np.sin(2 * np.pi * part) / (2 * np.pi))

    direction = np.stack([np.cos(turned(grid)), np.sin(turned(grid))], axis=-1)
    curve = CubicSpline(grid, direction).antiderivative()
    drift = curve(lap) / lap

    def place(u: Array) -> Array:
        u = np.mod(u, lap)
        return np.asarray(start + curve(u) - drift * u[:, None])

    return Route(place=place, heading=turned, curvature=curvature, length_m=lap)


def _random(path: RandomPath, rng: np.random.Generator) -> Route:
    low, high = np.array(path.low_m) + _MARGIN_M, np.array(path.high_m) - _MARGIN_M
    if (high - low < 2 - 2 * _MARGIN_M).any():
        size = np.array(path.high_m) - np.array(path.low_m)
        raise ConfigError(f"high_m: expected at least 2 m beyond low_m in x and y, got {size[0]:.2f} and {size[1]:.2f} m")
    for _ in range(_RANDOM_TRIES):
        drawn = _closed_curve(rng, low, high)
        if np.abs(drawn.curvature(np.arange(0, drawn.length_m, 0.02))).max() < 1 / _TIGHTEST_RANDOM_M:
            return drawn
    raise ConfigError(
        f"path: found no way with turns wider than {_TIGHTEST_RANDOM_M} m in the area {path.low_m} to {path.high_m}"
    )


def _closed_curve(rng: np.random.Generator, low: Array, high: Array) -> Route:
    """A closed smooth curve of several rounds, each an O or an 8 drawn by a loose hand, inside the area."""
    theta = 2 * np.pi * np.arange(_ROUND_POINTS) / _ROUND_POINTS
    rounds = []
    for _ in range(_ROUNDS):
        eight = rng.random() < 0.5
        y = _EIGHT_WIDTH * np.sin(2 * theta) if eight else np.sin(theta)
        loose = np.stack([np.cos(theta), y], axis=-1) * rng.uniform(0.75, 1.0, (_ROUND_POINTS, 1))
        rounds.append(loose + rng.uniform(-_LOOSE, _LOOSE, loose.shape))
    points = np.concatenate(rounds) * rng.choice([-1.0, 1.0], 2)
    bspline = BSpline.construct_fast(np.arange(-3.0, len(points) + 4), np.concatenate([points, points[:3]]), 3)
    xy = bspline(np.linspace(0, len(points), _CURVE_SAMPLES))
    xy = low + (xy - xy.min(axis=0)) / np.ptp(xy, axis=0) * (high - low)
    xy[-1] = xy[0]
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    length = float(distance[-1])
    curve = CubicSpline(distance, xy, bc_type="periodic")
    first, second = curve.derivative(), curve.derivative(2)
    angle = np.unwrap(np.arctan2(*first(distance).T[::-1]))
    turns = 2 * np.pi * np.round((angle[-1] - angle[0]) / (2 * np.pi))
    level = angle - turns * distance / length
    level[-1] = level[0]
    wobble = CubicSpline(distance, level, bc_type="periodic")

    def curvature(u: Array) -> Array:
        d, dd = first(np.mod(u, length)), second(np.mod(u, length))
        return np.asarray((d[:, 0] * dd[:, 1] - d[:, 1] * dd[:, 0]) / np.linalg.norm(d, axis=1) ** 3)

    return Route(
        place=lambda u: curve(np.mod(u, length)),
        heading=lambda u: wobble(np.mod(u, length)) + turns * u / length,
        curvature=curvature,
        length_m=length,
    )
