"""One control step of a robot: the newest order, the limits, the joints. Knows no processes and no clock."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from posefuse.teleoperation.follower import Follower, standing, step_follower, with_order
from posefuse.teleoperation.settings import TeleoperationSettings
from posefuse.teleoperation.values import Order, RobotState

from .protocol import Goal, Posture, Robot


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
        wanted = step_follower(self._paced(follower), now_ns, dt_s, settings, may_move=not self.posture.fault, left_out=left_out)
        if wanted.order is not follower.order:
            wanted = replace(wanted, order=follower.order)
        if not self._robot.reaches(_goal(wanted), dt_s) and not wanted.limited:
            wanted = step_follower(follower, now_ns, dt_s, settings, may_move=False, left_out=left_out)
            self._robot.reaches(_goal(wanted), dt_s)
        self._robot.carry_out(_goal(wanted), dt_s)
        self.posture = self._robot.posture()
        if wanted.stands and wanted.limited:
            # where the joints did not quite follow, their place counts from now on; nothing moves by that
            wanted = replace(_at(wanted, self.posture), limited=wanted.limited)
        self.follower = wanted
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


def _at(follower: Follower, posture: Posture) -> Follower:
    there = standing(posture.xyz_world, posture.wxyz)
    return replace(follower, moves=there.moves, turns=there.turns, wxyz=there.wxyz)


def _goal(follower: Follower) -> Goal:
    order = follower.order
    return Goal(
        xyz_world=follower.xyz,
        wxyz=follower.wxyz,
        velocity_world=follower.velocity,
        turn_rate_world=follower.turn_rate,
        grip=order.grip if order is not None else np.zeros(len(follower.moves), np.bool_),
        stands=follower.stands,
    )
