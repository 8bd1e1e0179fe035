"""Velocity, acceleration, jerk and box of one end effector: pure functions of three-vectors.

A motion that keeps all limits passes unchanged, to the last bit: there is no filter and no lag. Any other is followed as
closely as the limits allow. Whatever the target does, even jump or be missing, these hold after every step:

- the speed is at most the limit, or falls by at least the braking acceleration where the limit has just been lowered;
- the velocity changes by at most acceleration x step;
- the position stays in the box. Near a wall the velocity towards it is at most the one from which braking ends before it,
  v <= sqrt(a^2 dt^2 + 2 a d) - a dt with a third (by norm) of the acceleration for each axis, so that all axes can brake at once.

Why they hold: braking on all axes keeps them (tests/teleoperation/test_limits.py), the set of velocities that keeps them is
convex, and what is wanted is moved along a straight line towards braking until it lies in the set.
The jerk limit is for comfort; braking ignores it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from posefuse.core.arrays import Array

from .settings import Corner

# the velocity of the target is averaged over so long, to be followed without lag where limits bind
_TARGET_VELOCITY_S = 0.1
# how fast what was missed is made up for, and how fast the velocity follows the wanted one: about critically damped together.
# Chosen on made-up motions (3 mm of noise at rest leave 2.6 mm; a sine of 0.3 m/s lags 0 to 20 ms); see tests
_CATCH_UP_PER_S = 8.0
_FOLLOW_PER_S = 25.0
# share of the acceleration for catching up, so that the jerk limit leaves time to brake
_CATCH_UP_SHARE = 0.5
# a motion joins a target exactly where that needs no more velocity than this relative to the target's own
_JOIN_PER_S = 0.01


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Limits of one motion: m or rad and seconds. low, high: walls of the box."""

    speed: float
    acceleration: float
    jerk: float
    low: Corner | float = -math.inf
    high: Corner | float = math.inf


def _zero() -> Array:
    return np.zeros(3)


@dataclass(frozen=True, eq=False, kw_only=True)
class Motion:
    """State of a limited motion, (3,) each. target_velocity: mean. exact: the target was met exactly in the last step."""

    position: Array = field(default_factory=_zero)
    velocity: Array = field(default_factory=_zero)
    acceleration: Array = field(default_factory=_zero)
    target: Array | None = None
    target_velocity: Array = field(default_factory=_zero)
    exact: bool = False

    @property
    def speed(self) -> float:
        """Length of the velocity."""
        return norm(self.velocity)


def norm(v: Array) -> float:
    """Length."""
    return math.sqrt(float(v @ v))


def follow(motion: Motion, target: Array, bounds: Bounds, speed: float, dt_s: float) -> Motion:
    """One step towards the target. `speed`: limit now, at most that of the bounds counts."""
    speed = min(max(speed, 0.0), bounds.speed)
    mean = _target_velocity(motion, target, bounds, dt_s)
    exact = (target - motion.position) * (1 / dt_s)
    if _in_step(exact, mean, motion) and _keeps_all(exact, motion, bounds, speed, dt_s):
        return replace(_moved(motion, exact, dt_s, target, mean), exact=True)
    wanted = _limited_jerk(motion, _catching_up(motion, target, mean, bounds, speed), bounds, dt_s)
    return _moved(motion, _nearest_allowed(wanted, motion, bounds, speed, dt_s), dt_s, target, mean)


def rebased(motion: Motion) -> Motion:
    """The same motion with its position as the new origin."""
    return replace(motion, position=_zero(), target=None if motion.target is None else motion.target - motion.position)


def brake(motion: Motion, bounds: Bounds, dt_s: float, left_out: int = 0) -> Motion:
    """One step of braking as hard as the acceleration allows. left_out: steps that were due before and never done.

    The velocity of those falls too, so that a late process does not take longer to stop; the position moves once.
    """
    for _ in range(left_out):
        motion = replace(motion, velocity=brake(motion, bounds, dt_s).velocity)
    wanted = _hard_braked(motion.velocity, bounds.acceleration * dt_s)
    return _moved(motion, _nearest_allowed(wanted, motion, bounds, 0.0, dt_s), dt_s, None, _zero())


def _moved(motion: Motion, velocity: Array, dt_s: float, target: Array | None, mean: Array) -> Motion:
    return Motion(
        position=motion.position + velocity * dt_s,
        velocity=velocity,
        acceleration=(velocity - motion.velocity) * (1 / dt_s),
        target=target,
        target_velocity=mean,
    )


def _target_velocity(motion: Motion, target: Array, bounds: Bounds, dt_s: float) -> Array:
    if motion.target is None:
        return _zero()
    share = dt_s / (_TARGET_VELOCITY_S + dt_s)
    now = _shortened((target - motion.target) * (1 / dt_s), bounds.speed)
    return motion.target_velocity * (1 - share) + now * share


def _in_step(exact: Array, mean: Array, motion: Motion) -> bool:
    """Whether the motion meets the target already, or as evenly as the target moves: a noisy one would be thrown about."""
    return motion.exact or norm(exact - mean) <= _JOIN_PER_S


def _keeps_all(velocity: Array, motion: Motion, bounds: Bounds, speed: float, dt_s: float) -> bool:
    if norm(velocity) > speed:
        return False
    acceleration = (velocity - motion.velocity) * (1 / dt_s)
    if norm(acceleration) > bounds.acceleration or norm(acceleration - motion.acceleration) > bounds.jerk * dt_s:
        return False
    low, high = _caps(motion.position, bounds, dt_s)
    return bool(((low <= velocity) & (velocity <= high)).all())


def _catching_up(motion: Motion, target: Array, mean: Array, bounds: Bounds, speed: float) -> Array:
    """Velocity that follows the target's and makes up for the distance, with time left to brake."""
    missing = target - motion.position
    far = norm(missing)
    if far <= 0.0:
        return _shortened(mean, speed)
    rate = min(_CATCH_UP_PER_S * far, math.sqrt(2 * _CATCH_UP_SHARE * bounds.acceleration * far))
    return _shortened(mean + missing * (rate / far), speed)


def _limited_jerk(motion: Motion, wanted: Array, bounds: Bounds, dt_s: float) -> Array:
    """Velocity after one step towards the wanted one, within acceleration and jerk, so that it is met without overshoot."""
    gap = wanted - motion.velocity
    size = norm(gap)
    rate = min(_FOLLOW_PER_S * size, math.sqrt(2 * bounds.jerk * size), bounds.acceleration)
    acceleration = gap * (rate / size) if size > 0 else _zero()
    change = _shortened(acceleration - motion.acceleration, bounds.jerk * dt_s)
    return np.asarray(motion.velocity + (motion.acceleration + change) * dt_s)


def _nearest_allowed(wanted: Array, motion: Motion, bounds: Bounds, speed: float, dt_s: float) -> Array:
    """The velocity nearest to the wanted one on the straight line from braking on all axes, which is always allowed."""
    most = bounds.acceleration * dt_s
    v = motion.velocity
    start = np.copysign(np.maximum(0.0, np.abs(v) - most / math.sqrt(3.0)), v)
    way = wanted - start
    low, high = _caps(motion.position, bounds, dt_s)
    share = min(
        1.0,
        last_inside(start - v, way, most),
        last_inside(start, way, max(speed, norm(_hard_braked(v, most)), norm(start))),
        _share_below(start, way, high),
        _share_below(-start, -way, -low),
    )
    return np.asarray(start + way * max(share, 0.0))


def _hard_braked(v: Array, most: float) -> Array:
    size = norm(v)
    return v * (max(0.0, size - most) / size) if size > 0 else v


def _caps(position: Array, bounds: Bounds, dt_s: float) -> tuple[Array, Array]:
    """Lowest and highest velocity of each axis from which braking ends in the box."""
    a = bounds.acceleration / math.sqrt(3.0)
    return -_cap(position - bounds.low, a, dt_s), _cap(bounds.high - position, a, dt_s)


def _cap(distance: Array, acceleration: float, dt_s: float) -> Array:
    # a hair less than exact, so that rounding does not end behind the wall
    room = np.maximum(0.0, distance - 1e-9)
    step = acceleration * dt_s
    return np.maximum(0.0, np.sqrt(step * step + 2 * acceleration * room) - step)


def _share_below(start: Array, way: Array, most: Array) -> float:
    """Largest share of the way on which no axis passes its most; 0 where one is past it and the way leads no farther."""
    past = start + way > most
    if (way[past] <= 0).any():
        return 0.0
    return max(0.0, float(((most - start)[past] / way[past]).min(initial=1.0)))


def _shortened(a: Array, most: float) -> Array:
    size = norm(a)
    return a if size <= most else a * (most / size)


def last_inside(start: Array, way: Array, radius: float) -> float:
    """Largest share of the way from start, in 0..1, that stays in a ball about 0; start lies in it, up to rounding."""
    roots = _crossings(start, way, radius)
    return 1.0 if roots is None and norm(start) <= radius else 0.0 if roots is None else min(1.0, max(0.0, roots[1]))


def first_inside(start: Array, way: Array, radius: float) -> float:
    """Least share of the way from start, in 0..1, that lies in a ball about 0; 1 where it does not come there."""
    roots = _crossings(start, way, radius)
    return 1.0 if roots is None else min(1.0, max(0.0, roots[0]))


def _crossings(start: Array, way: Array, radius: float) -> tuple[float, float] | None:
    """Shares of the way where a straight line enters and leaves a ball about 0; None: it does not."""
    a, b, c = float(way @ way), float(start @ way), float(start @ start) - radius * radius
    inside = b * b - a * c
    if a <= 0.0 or inside < 0.0:
        return None
    return (-b - math.sqrt(inside)) / a, (-b + math.sqrt(inside)) / a
