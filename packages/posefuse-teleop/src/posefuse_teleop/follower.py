"""The robot's side: orders in, a limited motion of every end effector out, and one control step of a robot that follows it.

It does not trust its input: an old, repeated, non-finite or missing order makes it brake. No processes, no clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.se3 import quaternion_product, wxyz_from_rotvec

from .limits import Bounds, Motion, brake, follow, rebased
from .mapping import rotvec_between
from .settings import JERK_MPS3, TURN_ACCELERATION_RADPS2, TURN_JERK_RADPS3, LimitSettings, TeleoperationSettings
from .values import Order, Phase, RobotState

# m/s and rad/s of each axis: slower than this is no motion
_STANDING = 1e-6
# joints, and orientations of end effectors, may be so far from the commanded ones
FOLLOWS_RAD = 0.35
# and end effectors: what the default speed limit covers in 0.3 s, more than a usual controller lags
FOLLOWS_M = 0.15
# joints that are nearer than this to what was wanted follow it; what is left of the inverse kinematics is no motion of its own
_NEAR_M, _NEAR_RAD = 1e-5, 1e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class Follower:
    """Commanded motion of the robot: after a step, where the end effectors are to be, within all limits.

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
    def grip(self) -> Array:
        """(H,) bool, close the gripper."""
        return self.order.grip if self.order is not None else np.zeros(len(self.moves), np.bool_)

    @property
    def brakes(self) -> bool:
        """Whether the robot is to stop, or to stand: one with joints stops them in its own way."""
        return bool(self.limited)

    @property
    def stands(self) -> bool:
        """Whether nothing moves."""
        return bool(np.abs(self.velocity).max() <= _STANDING and np.abs(self.turn_rate).max() <= _STANDING)


def standing(xyz: Array, wxyz: Array) -> Follower:
    """A robot that stands at (H, 3), (H, 4)."""
    return Follower(
        moves=tuple(Motion(position=np.array(one)) for one in xyz),
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
    pace: float = 1.0,
    left_out: int = 0,
) -> Follower:
    """One control step of `dt_s`: follow the order, or brake.

    Args:
        may_move: False brakes, as where the robot has a fault. pace: share of the ordered speed limit that it can use.
        left_out: steps that were due before and never done, as the process was late.
    """
    order, limits = follower.order, settings.limits
    why = _why_brake(follower, now_ns, settings, may_move)
    if why or order is None:
        turns = tuple(brake(rebased(turn), turn_bounds(limits), dt_s, left_out) for turn in follower.turns)
        moves = tuple(brake(move, move_bounds(limits), dt_s, left_out) for move in follower.moves)
    else:
        speed_mps = order.speed_mps * pace
        turn_rate_radps = speed_mps / limits.speed_mps * limits.turn_rate_radps
        moves = tuple(
            follow(move, target, move_bounds(limits), speed_mps, dt_s)
            for move, target in zip(follower.moves, order.xyz_world, strict=True)
        )
        turns = tuple(
            follow(rebased(turn), rotvec_between(here, target), turn_bounds(limits), turn_rate_radps, dt_s)
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
    if not any(turn.position.any() for turn in turns):
        return wxyz
    turned = quaternion_product(wxyz_from_rotvec(np.array([turn.position for turn in turns])), wxyz)
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def move_bounds(limits: LimitSettings) -> Bounds:
    """Limits of an end effector's position."""
    return Bounds(
        speed=limits.speed_mps,
        acceleration=limits.acceleration_mps2,
        jerk=JERK_MPS3,
        low=limits.box_low_m,
        high=limits.box_high_m,
    )


def turn_bounds(limits: LimitSettings) -> Bounds:
    """Limits of its orientation."""
    return Bounds(speed=limits.turn_rate_radps, acceleration=TURN_ACCELERATION_RADPS2, jerk=TURN_JERK_RADPS3)


class Robot(Protocol):
    """A robot whose end effectors follow a commanded motion; used by the robot process only."""

    def state(self) -> RobotState:
        """How the robot is now, as far as it knows; raises PosefuseError where that cannot be known."""
        ...

    def move(self, wanted: Follower, dt_s: float, left_out: int = 0) -> None:
        """Go where `wanted` is, as far as joints, their limits and collisions allow; called once per control step.

        Args:
            left_out: steps that were due before and never done, as the process was late.
        """
        ...

    def close(self) -> None:
        """Leave it standing; safe to call twice."""
        ...


class Driver:
    """Keeps a robot within its limits, whatever orders come.

    Attributes:
        follower: commanded motion. state: of the robot after the last step, as the operator's side receives it.
    """

    def __init__(self, robot: Robot, settings: TeleoperationSettings) -> None:
        self._robot, self._settings = robot, settings
        self._late = 0
        now = robot.state()
        self.follower = standing(now.xyz_world, now.wxyz)
        self.state = self._as_followed(now, 0)

    def step(self, orders: Sequence[Order], now_ns: int, *, link: bool = True, late: int = 0, left_out: int = 0) -> RobotState:
        """Take orders in and do one step.

        Args:
            link: False when no order can come any more.
            late: steps by which this one is late; they are counted.
            left_out: those of them that will not be made up for.
        """
        settings, dt_s = self._settings, 1.0 / self._settings.robot.rate_hz
        follower = self.follower
        for order in orders:
            follower = with_order(follower, order, now_ns, settings)
        if not link:
            follower = replace(follower, order=None)
        self._late += late
        may_move, pace = not self.state.fault, self.state.pace
        wanted = step_follower(follower, now_ns, dt_s, settings, may_move=may_move, pace=pace, left_out=left_out)
        self._robot.move(wanted, dt_s, left_out)
        now = self._robot.state()
        self.follower = _as_commanded(wanted, follower, now, dt_s)
        self.state = self._as_followed(now, now_ns)
        return self.state

    def copied(self, robot: Robot) -> Driver:
        """The same state with another robot, which is where this one is."""
        other = copy(self)
        other._robot = robot
        return other

    def _as_followed(self, now: RobotState, now_ns: int) -> RobotState:
        """The robot's state with the motion that it was commanded."""
        follower, order = self.follower, self.follower.order
        return replace(
            now,
            sent_ns=now_ns,
            xyz_world=follower.xyz,
            wxyz=follower.wxyz,
            velocity_world=follower.velocity,
            turn_rate_world=follower.turn_rate,
            order_seq=order.seq if order is not None else -1,
            order_measured_ns=order.measured_ns if order is not None else 0,
            late=self._late,
            limited=follower.limited,
        )


def _as_commanded(wanted: Follower, before: Follower, robot: RobotState, dt_s: float) -> Follower:
    """The motion that the robot was really commanded: where its joints do not reach what was wanted, that counts."""
    off_m = float(np.abs(robot.xyz_world - wanted.xyz).max())
    off_rad = max(float(np.linalg.norm(rotvec_between(a, b))) for a, b in zip(wanted.wxyz, robot.wxyz, strict=True))
    if off_m == 0 and off_rad == 0:
        return wanted
    if off_m < _NEAR_M and off_rad < _NEAR_RAD:
        near = (replace(move, position=xyz) for move, xyz in zip(wanted.moves, robot.xyz_world, strict=True))
        return replace(wanted, moves=tuple(near), wxyz=robot.wxyz)
    moves = map(partial(_moved, dt_s=dt_s), wanted.moves, before.moves, robot.xyz_world, robot.velocity_world)
    turned = map(rotvec_between, before.wxyz, robot.wxyz)
    turns = map(partial(_moved, dt_s=dt_s), wanted.turns, before.turns, turned, robot.turn_rate_world)
    limited = wanted.limited or "the joints cannot follow"
    return replace(wanted, moves=tuple(moves), turns=tuple(turns), wxyz=robot.wxyz, limited=limited)


def _moved(wanted: Motion, before: Motion, position: Array, velocity: Array, *, dt_s: float) -> Motion:
    """A motion that did another step than the wanted one."""
    change = np.subtract(velocity, before.velocity) / dt_s
    return replace(wanted, position=position, velocity=velocity, acceleration=change, exact=False)
