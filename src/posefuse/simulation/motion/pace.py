"""When a walker is where along the route, and in which phase of the gait."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

from posefuse.core.arrays import Array

from .routes import Route

_STEP_M = 0.005
_SPEED_UP_MPS2 = 0.8
_SIDE_MPS2 = 1.0
_SLOWEST_MPS = 0.35
# step length over cadence is nearly constant at all speeds: 0.0064 m per step/min for adults (Sekiya & Nagasaki 1998)
_WALK_RATIO_M_MIN = 0.0064
_WALK_RATIO_LEG_M = 0.92
_SLOWEST_CYCLES_HZ = 0.55
_FLOOR_POWER = 8
# sides take short quick steps: a stride of this part of the leg length at most
_SIDE_STRIDE_LEGS = 0.6
# both feet on the floor, weight between them
STANDING_PHASE = 0.56


def cycles_hz(speed_mps: Array, leg_m: float) -> Array:
    """Gait cycles (two steps) per second at a walking speed; scaled to the leg as a pendulum (walk ratio ~ leg^1.5)."""
    ratio = _WALK_RATIO_M_MIN * (leg_m / _WALK_RATIO_LEG_M) ** 1.5
    brisk = np.asarray(speed_mps, np.float64) / (2 * np.sqrt(ratio * 60.0 * np.maximum(speed_mps, 1e-6)))
    return np.asarray((brisk**_FLOOR_POWER + _SLOWEST_CYCLES_HZ**_FLOOR_POWER) ** (1 / _FLOOR_POWER))


@dataclass(frozen=True, eq=False, kw_only=True)
class WalkPace:
    """Distance and gait phase over time.

    Phase counts gait cycles: the left heel strikes at whole numbers, the right at halves.

    Attributes:
        lap_s, lap_m, lap_cycles: of one lap, or to the end.
        loops: as the route.
    """

    lap_s: float
    lap_m: float
    lap_cycles: float
    loops: bool
    _distance: PchipInterpolator
    _phase: PchipInterpolator
    _time: PchipInterpolator
    _first_phase: float

    def distance_m(self, t_s: Array) -> Array:
        """Distance walked (T,)."""
        laps, t_s = self._lap(t_s, self.lap_s)
        return np.asarray(laps * self.lap_m + self._distance(t_s))

    def speed_mps(self, t_s: Array) -> Array:
        """Rate of `distance_m` (T,); 0 before the start and after the end."""
        _, within = self._lap(t_s, self.lap_s)
        moving = np.ones_like(within) if self.loops else (t_s > 0) & (t_s < self.lap_s)
        return np.asarray(self._distance(within, 1) * moving)

    def phase(self, t_s: Array) -> Array:
        """Gait cycles (T,) since the left heel strike before time 0."""
        laps, t_s = self._lap(t_s, self.lap_s)
        return np.asarray(self._first_phase + laps * self.lap_cycles + self._phase(t_s))

    def time_s(self, phase: Array) -> Array:
        """Inverse of `phase`."""
        laps, cycles = self._lap(phase - self._first_phase, self.lap_cycles)
        return np.asarray(laps * self.lap_s + self._time(cycles))

    def _lap(self, value: Array, lap: float) -> tuple[Array, Array]:
        if not self.loops:
            return np.zeros_like(value), np.clip(value, 0.0, lap)
        laps = np.floor(value / lap)
        return laps, value - laps * lap


def pace(route: Route, speed_mps: float, leg_m: float) -> WalkPace:
    """The speed asked for, slower in narrow turns and at ends, and the cadence that goes with it."""
    count = max(2, int(np.ceil(route.length_m / _STEP_M)))
    u = np.linspace(0.0, route.length_m, count + 1)
    v = _speed_along(route, u, speed_mps)
    t = np.concatenate([[0.0], np.cumsum(np.diff(u) * 2 / (v[1:] + v[:-1]))])
    hz = cycles_hz(v, leg_m)
    if route.facing_rad is not None:
        hz = np.maximum(hz, v / (_SIDE_STRIDE_LEGS * leg_m))
    phase = np.concatenate([[0.0], np.cumsum(np.diff(t) * (hz[1:] + hz[:-1]) / 2)])
    if not route.loops:
        u, t, phase = _closed_stance(u, t, phase, hz[-1])
    return WalkPace(
        lap_s=float(t[-1]),
        lap_m=float(u[-1]),
        lap_cycles=float(phase[-1]),
        loops=route.loops,
        _distance=PchipInterpolator(t, u),
        _phase=PchipInterpolator(t, phase),
        _time=PchipInterpolator(phase, t),
        _first_phase=0.0 if route.loops else STANDING_PHASE,
    )


def _closed_stance(u: Array, t: Array, phase: Array, hz: float) -> tuple[Array, Array, Array]:
    """Step on the spot after the arrival until both feet stand where the way ends."""
    # a foot is put where the walker is a quarter cycle after this phase or before it
    last = np.ceil((phase[-1] + 0.25) * 2) / 2
    more = np.linspace(0.0, last - phase[-1], 50)[1:]
    return np.append(u, np.full(49, u[-1])), np.append(t, t[-1] + more / hz), np.append(phase, phase[-1] + more)


def _speed_along(route: Route, u: Array, speed_mps: float) -> Array:
    limit = np.full_like(u, speed_mps)
    bend = np.abs(route.curvature(u))
    if np.ptp(bend) > 1e-6:
        limit = np.minimum(limit, np.sqrt(_SIDE_MPS2 / np.maximum(bend, 1e-9)))
    for end in route.ends_m:
        gap = np.abs(u - end)
        gap = np.minimum(gap, route.length_m - gap) if route.loops else gap
        limit = np.minimum(limit, np.sqrt(_SLOWEST_MPS**2 + 2 * _SPEED_UP_MPS2 * gap))
    return np.sqrt(_within_acceleration(limit**2, 2 * _SPEED_UP_MPS2 * (u[1] - u[0]), route.loops))


def _within_acceleration(squared: Array, rise: float, loops: bool) -> Array:
    """The largest squared speeds below `squared` that change by at most `rise` from sample to sample, both ways."""
    line = np.concatenate([squared[:-1]] * 3) if loops else squared
    ramp = rise * np.arange(len(line))
    ahead = np.minimum.accumulate(line - ramp) + ramp
    both = np.minimum.accumulate((ahead + ramp)[::-1])[::-1] - ramp
    if not loops:
        return np.asarray(both)
    count = len(squared) - 1
    return np.append(both[count : 2 * count], both[2 * count])
