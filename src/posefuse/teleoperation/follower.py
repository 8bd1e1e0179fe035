"""The robot's side: orders in, a limited motion of every end effector out. One pure step, and its own watchdog.

It does not trust its input: an old, repeated, non-finite or missing order makes it brake.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.se3 import quaternion_product, wxyz_from_rotvec

from .limits import Bounds, Motion, Vector, brake, follow, rebased
from .mapping import rotvec_between
from .settings import LimitSettings, TeleoperationSettings
from .values import Order, Phase

# m/s and rad/s: slower than this is no motion
STANDING = 1e-6


@dataclass(frozen=True, eq=False, kw_only=True)
class Follower:
    """Commanded motion of the robot.

    Attributes:
        moves: one limited motion per end effector. turns: of its orientation, positions counted from `wxyz`.
        wxyz: (H, 4). order: the newest good one. received_ns: when it arrived; None: none yet. limited: why it brakes.
    """

    moves: tuple[Motion, ...]
    turns: tuple[Motion, ...]
    wxyz: Array
    order: Order | None = None
    received_ns: int | None = None
    limited: str = "no order yet"

    @property
    def xyz(self) -> Array:
        """(H, 3) commanded positions."""
        return np.array([move.position for move in self.moves])

    @property
    def velocity(self) -> Array:
        """(H, 3) commanded velocities."""
        return np.array([move.velocity for move in self.moves])

    @property
    def turn_rate(self) -> Array:
        """(H, 3) commanded angular velocities, world axes."""
        return np.array([turn.velocity for turn in self.turns])

    @property
    def stands(self) -> bool:
        """Whether nothing moves."""
        return all(motion.speed <= STANDING for motion in (*self.moves, *self.turns))


def standing(xyz: Array, wxyz: Array) -> Follower:
    """A robot that stands at (H, 3), (H, 4)."""
    return Follower(
        moves=tuple(Motion(position=as_vector(one)) for one in xyz),
        turns=tuple(Motion() for _ in xyz),
        wxyz=np.array(wxyz, np.float64),
    )


def with_order(follower: Follower, order: Order, now_ns: int, settings: TeleoperationSettings) -> Follower:
    """Take an order; one that is not newer than the last, too old, from the future or not finite is ignored."""
    longest_ns = settings.robot.watchdog_s * 1e9
    old = follower.order is not None and order.seq <= follower.order.seq
    if old or not -longest_ns <= now_ns - order.sent_ns <= longest_ns or not order.usable:
        return follower
    if order.xyz_world.shape != (len(follower.moves), 3):
        return follower
    return replace(follower, order=order, received_ns=now_ns)


def step_follower(
    follower: Follower,
    now_ns: int,
    dt_s: float,
    settings: TeleoperationSettings,
    *,
    may_move: bool = True,
    left_out: int = 0,
) -> Follower:
    """One control step of `dt_s`: follow the order, or brake.

    Args:
        may_move: False brakes, as where the robot has a fault.
        left_out: steps that were due before and never done, as the process was late.
    """
    order, limits = follower.order, settings.limits
    why = _why_brake(follower, now_ns, settings, may_move)
    if why or order is None:
        turns = tuple(brake(rebased(turn), turn_bounds(limits), dt_s, left_out) for turn in follower.turns)
        moves = tuple(brake(move, move_bounds(limits), dt_s, left_out) for move in follower.moves)
    else:
        pace = order.speed_mps / limits.speed_mps
        moves = tuple(
            follow(move, as_vector(target), move_bounds(limits), order.speed_mps, dt_s)
            for move, target in zip(follower.moves, order.xyz_world, strict=True)
        )
        turns = tuple(
            follow(
                rebased(turn),
                as_vector(rotvec_between(here, target)),
                turn_bounds(limits),
                pace * limits.turn_rate_radps,
                dt_s,
            )
            for turn, here, target in zip(follower.turns, follower.wxyz, order.wxyz, strict=True)
        )
    return replace(follower, moves=moves, turns=turns, wxyz=_turned(follower.wxyz, turns), limited=why)


def _why_brake(follower: Follower, now_ns: int, settings: TeleoperationSettings, may_move: bool) -> str:
    if follower.order is None or follower.received_ns is None:
        return "no order yet"
    # by when it was sent: orders that wait in a queue do not keep the robot moving
    if not 0 <= now_ns - min(follower.received_ns, follower.order.sent_ns) <= settings.robot.watchdog_s * 1e9:
        return "watchdog: no new order"
    if follower.order.phase is not Phase.ENGAGED:
        return follower.order.phase.value
    return "" if may_move else "the robot has a fault"


def _turned(wxyz: Array, turns: tuple[Motion, ...]) -> Array:
    if not any(any(turn.position) for turn in turns):
        return wxyz
    turned = quaternion_product(wxyz_from_rotvec(np.array([turn.position for turn in turns])), wxyz)
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def move_bounds(limits: LimitSettings) -> Bounds:
    """Limits of an end effector's position."""
    return Bounds(
        speed=limits.speed_mps,
        acceleration=limits.acceleration_mps2,
        jerk=limits.jerk_mps3,
        low=limits.box_low_m,
        high=limits.box_high_m,
    )


def turn_bounds(limits: LimitSettings) -> Bounds:
    """Limits of its orientation."""
    return Bounds(speed=limits.turn_rate_radps, acceleration=limits.turn_acceleration_radps2, jerk=limits.turn_jerk_radps3)


def as_vector(one: Array) -> Vector:
    """Three numbers as the limits take them."""
    return float(one[0]), float(one[1]), float(one[2])
