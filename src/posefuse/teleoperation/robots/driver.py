"""What a robot must offer to be teleoperated, and one control step of it: order, limits, joints. No processes, no clock."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Protocol

import numpy as np

from posefuse.core.arrays import Array
from posefuse.teleoperation.follower import STANDING, Follower, as_vector, standing, step_follower, with_order
from posefuse.teleoperation.limits import Motion
from posefuse.teleoperation.mapping import rotvec_between
from posefuse.teleoperation.settings import TeleoperationSettings
from posefuse.teleoperation.values import Order, RobotState

# joints, and orientations of end effectors, may be so far from the commanded ones
FOLLOWS_RAD = 0.35
# and end effectors: what the default speed limit covers in 0.3 s, more than a usual controller lags
FOLLOWS_M = 0.15


@dataclass(frozen=True, eq=False, kw_only=True)
class Goal:
    """Where the end effectors are to be at the end of a control step, already within all limits.

    Attributes:
        xyz_world, wxyz: (H, 3), (H, 4). velocity_world, turn_rate_world: (H, 3), (H, 3). grip: (H,) bool.
        brakes: the robot is to stop, or to stand: one with joints stops them in its own way.
    """

    xyz_world: Array
    wxyz: Array
    velocity_world: Array
    turn_rate_world: Array
    grip: Array
    brakes: bool

    @property
    def stands(self) -> bool:
        """Whether nothing is to move in this step."""
        return bool(np.abs(self.velocity_world).max() <= STANDING and np.abs(self.turn_rate_world).max() <= STANDING)


@dataclass(frozen=True, eq=False, kw_only=True)
class Posture:
    """How the robot is.

    Attributes:
        xyz_world, wxyz: (H, 3), (H, 4) end effectors as commanded, from the commanded joint positions.
        velocity_world, turn_rate_world: (H, 3), (H, 3) of them, as commanded.
        measured_xyz_world: (H, 3) as they are. q: (J,) joints as commanded, rad or m. spheres_world: (M, 4) that cover the robot.
        fault: why it cannot move; empty when it can.
    """

    xyz_world: Array
    wxyz: Array
    velocity_world: Array
    turn_rate_world: Array
    measured_xyz_world: Array
    q: Array = field(default_factory=lambda: np.zeros(0))
    spheres_world: Array = field(default_factory=lambda: np.zeros((0, 4)))
    fault: str = ""


class Robot(Protocol):
    """A robot whose end effectors follow goals; used by the robot process only."""

    def posture(self) -> Posture:
        """How the robot is now; raises PosefuseError where that cannot be known."""
        ...

    def pace(self) -> float:
        """Share of the speed limit that the robot can use now, in 0..1: less near singularities."""
        ...

    def move(self, goal: Goal, dt_s: float, left_out: int = 0) -> None:
        """Go there, as far as joints, their limits and collisions allow; called once per control step.

        Args:
            left_out: steps that were due before and never done, as the process was late.
        """
        ...

    def close(self) -> None:
        """Leave it standing; safe to call twice."""
        ...


# joints that are nearer than this to what was wanted follow it; what is left of the inverse kinematics is no motion of its own
_FOLLOWS_M, _FOLLOWS_RAD = 1e-5, 1e-4


class Driver:
    """Keeps a robot within its limits, whatever orders come.

    Attributes:
        follower: commanded motion. posture: of the robot, after the last step.
    """

    def __init__(self, robot: Robot, settings: TeleoperationSettings) -> None:
        self._robot, self._settings = robot, settings
        self.posture = robot.posture()
        self.follower = standing(self.posture.xyz_world, self.posture.wxyz)
        self._late = 0

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
        may_move = not self.posture.fault
        wanted = step_follower(self._paced(follower), now_ns, dt_s, settings, may_move=may_move, left_out=left_out)
        self._robot.move(_goal(wanted), dt_s, left_out)
        self.posture = self._robot.posture()
        self.follower = replace(_as_commanded(wanted, follower, self.posture, dt_s), order=follower.order)
        return self.state(now_ns)

    def state(self, now_ns: int) -> RobotState:
        """What the operator's side receives."""
        follower, posture = self.follower, self.posture
        order = follower.order
        return RobotState(
            sent_ns=now_ns,
            xyz_world=follower.xyz,
            wxyz=follower.wxyz,
            velocity_world=follower.velocity,
            measured_xyz_world=posture.measured_xyz_world,
            q_rad=posture.q,
            spheres_world=posture.spheres_world,
            fault=posture.fault,
            order_seq=order.seq if order is not None else -1,
            order_measured_ns=order.measured_ns if order is not None else 0,
            late=self._late,
            limited=follower.limited,
        )

    def copied(self, robot: Robot) -> Driver:
        """The same state with another robot, which is where this one is."""
        other = copy(self)
        other._robot = robot
        return other

    def _paced(self, follower: Follower) -> Follower:
        order, pace = follower.order, self._robot.pace()
        if order is None or pace >= 1.0:
            return follower
        return replace(follower, order=replace(order, speed_mps=order.speed_mps * pace))


def _as_commanded(wanted: Follower, before: Follower, posture: Posture, dt_s: float) -> Follower:
    """The motion that the robot was really commanded: where its joints do not reach what was wanted, that counts."""
    off_m = float(np.abs(posture.xyz_world - wanted.xyz).max())
    off_rad = max(float(np.linalg.norm(rotvec_between(a, b))) for a, b in zip(wanted.wxyz, posture.wxyz, strict=True))
    if off_m == 0 and off_rad == 0:
        return wanted
    if off_m < _FOLLOWS_M and off_rad < _FOLLOWS_RAD:
        near = (replace(move, position=as_vector(xyz)) for move, xyz in zip(wanted.moves, posture.xyz_world, strict=True))
        return replace(wanted, moves=tuple(near), wxyz=posture.wxyz)
    moves = map(partial(_moved, dt_s=dt_s), wanted.moves, before.moves, posture.xyz_world, posture.velocity_world)
    turned = map(rotvec_between, before.wxyz, posture.wxyz)
    turns = map(partial(_moved, dt_s=dt_s), wanted.turns, before.turns, turned, posture.turn_rate_world)
    limited = wanted.limited or "the joints cannot follow"
    return replace(wanted, moves=tuple(moves), turns=tuple(turns), wxyz=posture.wxyz, limited=limited)


def _moved(wanted: Motion, before: Motion, position: Array, velocity: Array, *, dt_s: float) -> Motion:
    """A motion that did another step than the wanted one."""
    change = np.subtract(velocity, before.velocity) / dt_s
    return replace(
        wanted, position=as_vector(position), velocity=as_vector(velocity), acceleration=as_vector(change), exact=False
    )


def _goal(follower: Follower) -> Goal:
    order = follower.order
    return Goal(
        xyz_world=follower.xyz,
        wxyz=follower.wxyz,
        velocity_world=follower.velocity,
        turn_rate_world=follower.turn_rate,
        grip=order.grip if order is not None else np.zeros(len(follower.moves), np.bool_),
        brakes=bool(follower.limited),
    )
