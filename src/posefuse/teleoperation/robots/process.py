"""The robot's process: control steps on time, with its own watchdog. It continues until the robot stands, even alone."""

from __future__ import annotations

import gc
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass

from posefuse.core import PosefuseError
from posefuse.foundation.channel import Channel, ChannelClosed
from posefuse.foundation.platform import punctual
from posefuse.teleoperation.values import Order, RobotState

from .driver import Driver, Robot
from .plan import RobotPlan, RosPlan
from .reports import OutletReporter, open_reporters

_S = 1_000_000_000
# a step that is later than this is left out, so that the robot does not hurry after a pause
_MOST_BEHIND = 2


@dataclass(frozen=True)
class Failed:
    """The robot cannot be driven."""

    error: PosefuseError


class Leave:
    """End: brake, then leave."""


def run_robot(channel: Channel, plan: RobotPlan) -> None:
    """Entry point of the process; the other end of `channel` sends orders and receives states."""
    try:
        robot = built(plan)
        reporters = open_reporters(plan.ros, plan.record, plan.settings)
    except PosefuseError as error:
        channel.send(Failed(error), wait_s=1.0)
        return
    asked: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: asked.append(number))
    try:
        with punctual():
            _drive(channel, Driver(robot, plan.settings), plan.settings.robot.rate_hz, reporters, asked)
    finally:
        robot.close()
        for reporter in reporters:
            reporter.close()


def built(plan: RobotPlan) -> Robot:
    """The robot of a plan."""
    from .mujoco_robot import MujocoRobot, mujoco_model, placed

    if plan.command is not None:
        from .ros_robot import open_ros_robot

        return open_ros_robot(plan.command, plan.ros or RosPlan(), plan.model, plan.frames, plan.settings)
    place = placed(plan.settings.robot.position_xy_m, plan.settings.robot.heading_deg)
    robot = MujocoRobot(mujoco_model(plan.model, plan.settings.hands, plan.scene), plan.frames, plan.settings.limits, place)
    if plan.view:
        robot.open_viewer()
    return robot


def _drive(channel: Channel, driver: Driver, rate_hz: float, reporters: Sequence[OutletReporter], asked: Sequence[int]) -> None:
    """Control steps until the robot stands after a `Leave`, a cut link or a signal; `asked` gets those."""
    period_ns = round(_S / rate_hz)
    due_ns, late, left_out, link, leaving = time.monotonic_ns() + period_ns, 0, 0, True, False
    gc.collect()
    gc.freeze()
    while True:
        time.sleep(max(0, due_ns - time.monotonic_ns()) / _S)
        orders: list[Order] = []
        try:
            while link and (message := channel.receive()) is not None:
                if isinstance(message, Order):
                    orders.append(message)
                leaving = leaving or isinstance(message, Leave)
        except ChannelClosed:
            link = False
        leaving = leaving or bool(asked)
        state = driver.step(orders, time.monotonic_ns(), link=link and not leaving, late=late, left_out=left_out)
        link = link and _delivered(channel, state)
        for reporter in reporters:
            reporter.take(state, driver.follower.order)
        if (leaving or not link) and driver.follower.stands:
            return
        due_ns += period_ns
        late = max(0, (time.monotonic_ns() - due_ns) // period_ns)
        left_out = late if late > _MOST_BEHIND else 0
        if left_out:
            due_ns = time.monotonic_ns()


def _delivered(channel: Channel, state: RobotState) -> bool:
    try:
        channel.send(state)
    except ChannelClosed:
        return False
    return True
