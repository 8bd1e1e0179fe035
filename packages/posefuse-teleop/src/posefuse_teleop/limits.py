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
from dataclasses import dataclass, replace

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)
_NO_WALL = (-math.inf, -math.inf, -math.inf), (math.inf, math.inf, math.inf)
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
    low: Vector = _NO_WALL[0]
    high: Vector = _NO_WALL[1]


@dataclass(frozen=True, kw_only=True)
class Motion:
    """State of a limited motion. target_velocity: mean. exact: the target was met exactly in the last step."""

    position: Vector = ZERO
    velocity: Vector = ZERO
    acceleration: Vector = ZERO
    target: Vector | None = None
    target_velocity: Vector = ZERO
    exact: bool = False

    @property
    def speed(self) -> float:
        """Length of the velocity."""
        return norm(self.velocity)


def norm(v: Vector) -> float:
    """Length."""
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


def follow(motion: Motion, target: Vector, bounds: Bounds, speed: float, dt_s: float) -> Motion:
    """One step towards the target. `speed`: limit now, at most that of the bounds counts."""
    speed = min(max(speed, 0.0), bounds.speed)
    mean = _target_velocity(motion, target, bounds, dt_s)
    exact = _scaled(_minus(target, motion.position), 1 / dt_s)
    if _in_step(exact, mean, motion) and _keeps_all(exact, motion, bounds, speed, dt_s):
        return replace(_moved(motion, exact, dt_s, target, mean), exact=True)
    wanted = _limited_jerk(motion, _catching_up(motion, target, mean, bounds, speed), bounds, dt_s)
    return _moved(motion, _nearest_allowed(wanted, motion, bounds, speed, dt_s), dt_s, target, mean)


def rebased(motion: Motion) -> Motion:
    """The same motion with its position as the new origin."""
    return replace(motion, position=ZERO, target=_minus(motion.target, motion.position) if motion.target else None)


def brake(motion: Motion, bounds: Bounds, dt_s: float, left_out: int = 0) -> Motion:
    """One step of braking as hard as the acceleration allows. left_out: steps that were due before and never done.

    The velocity of those falls too, so that a late process does not take longer to stop; the position moves once.
    """
    for _ in range(left_out):
        motion = replace(motion, velocity=brake(motion, bounds, dt_s).velocity)
    speed = motion.speed
    left = max(0.0, speed - bounds.acceleration * dt_s)
    wanted = _scaled(motion.velocity, left / speed) if speed > 0 else ZERO
    return _moved(motion, _nearest_allowed(wanted, motion, bounds, 0.0, dt_s), dt_s, None, ZERO)


def _moved(motion: Motion, velocity: Vector, dt_s: float, target: Vector | None, mean: Vector) -> Motion:
    return Motion(
        position=_plus(motion.position, _scaled(velocity, dt_s)),
        velocity=velocity,
        acceleration=_scaled(_minus(velocity, motion.velocity), 1 / dt_s),
        target=target,
        target_velocity=mean,
    )


def _target_velocity(motion: Motion, target: Vector, bounds: Bounds, dt_s: float) -> Vector:
    if motion.target is None:
        return ZERO
    share = dt_s / (_TARGET_VELOCITY_S + dt_s)
    now = _shortened(_scaled(_minus(target, motion.target), 1 / dt_s), bounds.speed)
    return _plus(_scaled(motion.target_velocity, 1 - share), _scaled(now, share))


def _in_step(exact: Vector, mean: Vector, motion: Motion) -> bool:
    """Whether the motion meets the target already, or as evenly as the target moves: a noisy one would be thrown about."""
    return motion.exact or norm(_minus(exact, mean)) <= _JOIN_PER_S


def _keeps_all(velocity: Vector, motion: Motion, bounds: Bounds, speed: float, dt_s: float) -> bool:
    if norm(velocity) > speed:
        return False
    acceleration = _scaled(_minus(velocity, motion.velocity), 1 / dt_s)
    if norm(acceleration) > bounds.acceleration or norm(_minus(acceleration, motion.acceleration)) > bounds.jerk * dt_s:
        return False
    low, high = _caps(motion.position, bounds, dt_s)
    return all(low[i] <= velocity[i] <= high[i] for i in range(3))


def _catching_up(motion: Motion, target: Vector, mean: Vector, bounds: Bounds, speed: float) -> Vector:
    """Velocity that follows the target's and makes up for the distance, with time left to brake."""
    missing = _minus(target, motion.position)
    far = norm(missing)
    if far <= 0.0:
        return _shortened(mean, speed)
    rate = min(_CATCH_UP_PER_S * far, math.sqrt(2 * _CATCH_UP_SHARE * bounds.acceleration * far))
    return _shortened(_plus(mean, _scaled(missing, rate / far)), speed)


def _limited_jerk(motion: Motion, wanted: Vector, bounds: Bounds, dt_s: float) -> Vector:
    """Velocity after one step towards the wanted one, within acceleration and jerk, so that it is met without overshoot."""
    gap = _minus(wanted, motion.velocity)
    size = norm(gap)
    rate = min(_FOLLOW_PER_S * size, math.sqrt(2 * bounds.jerk * size), bounds.acceleration)
    acceleration = _scaled(gap, rate / size) if size > 0 else ZERO
    change = _shortened(_minus(acceleration, motion.acceleration), bounds.jerk * dt_s)
    return _plus(motion.velocity, _scaled(_plus(motion.acceleration, change), dt_s))


def _nearest_allowed(wanted: Vector, motion: Motion, bounds: Bounds, speed: float, dt_s: float) -> Vector:
    """The velocity nearest to the wanted one on the straight line from braking on all axes, which is always allowed."""
    most = bounds.acceleration * dt_s
    step = most / math.sqrt(3.0)
    v = motion.velocity
    safe = tuple(math.copysign(max(0.0, abs(one) - step), one) for one in v)
    start: Vector = (safe[0], safe[1], safe[2])
    way = _minus(wanted, start)
    low, high = _caps(motion.position, bounds, dt_s)
    share = min(
        1.0,
        _share_in_ball(_minus(start, v), way, most),
        _share_in_ball(start, way, max(speed, norm(_hard_braked(v, most)), norm(start))),
        *(_share_below(start[i], way[i], high[i]) for i in range(3)),
        *(_share_below(-start[i], -way[i], -low[i]) for i in range(3)),
    )
    return _plus(start, _scaled(way, max(share, 0.0)))


def _hard_braked(v: Vector, most: float) -> Vector:
    size = norm(v)
    return _scaled(v, max(0.0, size - most) / size) if size > 0 else ZERO


def _caps(position: Vector, bounds: Bounds, dt_s: float) -> tuple[Vector, Vector]:
    """Lowest and highest velocity of each axis from which braking ends in the box."""
    a = bounds.acceleration / math.sqrt(3.0)
    down = tuple(-_cap(position[i] - bounds.low[i], a, dt_s) for i in range(3))
    up = tuple(_cap(bounds.high[i] - position[i], a, dt_s) for i in range(3))
    return (down[0], down[1], down[2]), (up[0], up[1], up[2])


def _cap(distance: float, acceleration: float, dt_s: float) -> float:
    if distance == math.inf:
        return math.inf
    # a hair less than exact, so that rounding does not end behind the wall
    room = max(0.0, distance - 1e-9)
    step = acceleration * dt_s
    return max(0.0, math.sqrt(step * step + 2 * acceleration * room) - step)


def _share_in_ball(start: Vector, way: Vector, radius: float) -> float:
    """Largest share of the way from start that stays in a ball about 0; start lies in it, up to rounding."""
    a = way[0] * way[0] + way[1] * way[1] + way[2] * way[2]
    if a <= 0.0:
        return 1.0
    b = start[0] * way[0] + start[1] * way[1] + start[2] * way[2]
    c = start[0] * start[0] + start[1] * start[1] + start[2] * start[2] - radius * radius
    inside = b * b - a * c
    return (-b + math.sqrt(inside)) / a if inside > 0 else 0.0


def _share_below(start: float, way: float, most: float) -> float:
    return 1.0 if start + way <= most else max(0.0, (most - start) / way) if way > 0 else 0.0


def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _scaled(a: Vector, by: float) -> Vector:
    return a[0] * by, a[1] * by, a[2] * by


def _shortened(a: Vector, most: float) -> Vector:
    size = norm(a)
    return a if size <= most else _scaled(a, most / size)
