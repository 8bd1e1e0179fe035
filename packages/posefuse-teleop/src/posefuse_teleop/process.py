"""The robot's process: control steps on time, with its own watchdog. It continues until the robot stands, even alone.

`RobotLink` is the process as the operator's side sees it.
"""

from __future__ import annotations

import gc
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from posefuse.core import PosefuseError, SourceError
from posefuse.core.extras import package_of_extra
from posefuse.foundation.channel import Channel, ChannelClosed
from posefuse.foundation.platform import punctual
from posefuse.foundation.worker import Worker

from .follower import Driver, Robot
from .settings import RosPlan, TeleoperationSettings
from .values import Order, RobotState

if TYPE_CHECKING:
    from .ros import Reporter

_S = 1_000_000_000
# a step that is later than this is left out, so that the robot does not hurry after a pause
_MOST_BEHIND = 2
# for the first state, and for braking at the end
_READY_S, _LEAVE_S = 60.0, 3.0


@dataclass(frozen=True, kw_only=True)
class RobotPlan:
    """What the process is to drive.

    Attributes:
        settings: limits and rates. model: MJCF file; None: our own robot. frames: site of each hand.
        command: None drives the model in MuJoCo; ``pose`` or ``joints`` drives a robot over ROS.
        ros: where ROS is; None: none. record: .mcap file of commands and states; None: none. view: open MuJoCo's viewer.
        scene: MJCF text instead of a file, e.g. with boxes to move.
    """

    settings: TeleoperationSettings
    model: Path | None = None
    frames: tuple[str, ...] = ("right_hand",)
    command: str | None = None
    ros: RosPlan | None = None
    record: Path | None = None
    view: bool = False
    scene: str | None = None


class Leave:
    """End: brake, then leave."""


def run_robot(channel: Channel, plan: RobotPlan) -> None:
    """Entry point of the process; the other end of `channel` sends orders and receives states, or why there are none."""
    reporters: Sequence[Reporter] = ()
    try:
        robot = built(plan)
        if plan.ros is not None or plan.record is not None:
            ros = package_of_extra("posefuse_teleop.ros", "ros")
            reporters = ros.open_reporters(plan.ros, plan.record, plan.settings)
    except PosefuseError as error:
        channel.send(error, wait_s=1.0)
        return
    asked: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: asked.append(number))
    try:
        with punctual(), _failures_sent(channel, plan):
            _drive(channel, Driver(robot, plan.settings), plan.settings.robot.rate_hz, reporters, asked)
    finally:
        robot.close()
        for reporter in reporters:
            with _failures_sent(channel, plan):
                reporter.close()


@contextmanager
def _failures_sent(channel: Channel, plan: RobotPlan) -> Iterator[None]:
    """Send what keeps the robot from being driven, or its record from being written, to the operator's side."""
    try:
        yield
        return
    except PosefuseError as error:
        failure = error
    except OSError as error:
        failure = SourceError(f"{plan.record}: cannot be written ({error.strerror})")
    with suppress(ChannelClosed):
        channel.send(failure, wait_s=1.0)


def built(plan: RobotPlan) -> Robot:
    """The robot of a plan."""
    from .mujoco_robot import MujocoRobot, mujoco_model, placed

    if plan.command is not None:
        ros = package_of_extra("posefuse_teleop.ros_robot", "ros")
        robot: Robot = ros.open_ros_robot(plan.command, plan.ros or RosPlan(), plan.model, plan.frames, plan.settings)
        return robot
    place = placed(plan.settings.robot.position_xy_m, plan.settings.robot.heading_deg)
    simulated = MujocoRobot(mujoco_model(plan.model, plan.settings.hands, plan.scene), plan.frames, plan.settings.limits, place)
    if plan.view:
        simulated.open_viewer()
    return simulated


def _drive(channel: Channel, driver: Driver, rate_hz: float, reporters: Sequence[Reporter], asked: Sequence[int]) -> None:
    """Control steps until the robot stands after a `Leave`, a cut link, a signal, or a reporter that failed.

    asked: gets the signals. Raises what the reporter raised.
    """
    period_ns, failed = round(_S / rate_hz), None
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
        try:
            for reporter in reporters:
                reporter.take(state, driver.follower.order)
        except (PosefuseError, OSError) as error:
            failed, leaving, reporters = error, True, ()
        if (leaving or not link) and driver.follower.stands:
            break
        due_ns += period_ns
        late = max(0, (time.monotonic_ns() - due_ns) // period_ns)
        left_out = late if late > _MOST_BEHIND else 0
        if left_out:
            due_ns = time.monotonic_ns()
    if failed is not None:
        raise failed


def _delivered(channel: Channel, state: RobotState) -> bool:
    try:
        channel.send(state)
    except ChannelClosed:
        return False
    return True


class RobotLink:
    """The robot's process, as the operator's side sees it.

    Attributes:
        pid: of the process. state: the newest; None before the first. trouble: what went wrong at its end; empty: nothing.
    """

    def __init__(self, plan: RobotPlan) -> None:
        self.state: RobotState | None = None
        self.trouble = ""
        # a robot that lost its link brakes before its process ends
        self._worker = Worker(run_robot, closed_s=_LEAVE_S)
        self._worker.start(plan)
        self.pid = self._worker.pid

    def wait_ready(self) -> None:
        """Until the first state; raises PosefuseError where the robot cannot be driven."""
        end_s = time.monotonic() + _READY_S
        while self.state is None:
            if not self._worker.wait(0.2) and time.monotonic() > end_s:
                raise SourceError(f"robot: no state within {_READY_S:g} s")
            self.poll()

    def poll(self) -> RobotState | None:
        """The newest state that came since the last call; raises PosefuseError when the process is gone or gives up."""
        newest = None
        while (message := self._worker.receive()) is not None:
            if isinstance(message, PosefuseError):
                raise message
            self.state = newest = message
        self._check()
        return newest

    def send(self, order: Order) -> None:
        """Hand an order on; never waits."""
        self._worker.send(order)
        self._check()

    def close(self) -> None:
        """Let the robot brake and its process leave."""
        self._worker.send(Leave())
        end_s = time.monotonic() + _LEAVE_S
        while self._worker.wait(max(0.0, end_s - time.monotonic())):
            if isinstance(message := self._worker.receive(), PosefuseError):
                self.trouble = str(message)
        self._worker.end(_LEAVE_S)

    def _check(self) -> None:
        if not self._worker.running:
            raise SourceError("robot: its process has ended")
