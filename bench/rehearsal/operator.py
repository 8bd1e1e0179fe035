"""An operator's side and a robot, tick by tick at 100 Hz, in simulated time, so that the load of the machine does not matter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from posefuse.core.arrays import Array
from posefuse_teleop.follower import Driver
from posefuse_teleop.gate import Beat, Pressed
from posefuse_teleop.session import Operator, OperatorNews, step_operator
from posefuse_teleop.settings import TeleoperationSettings
from posefuse_teleop.values import CameraReport, OperatorView, RobotState

from .person import person_view

RATE_HZ = 100.0
_START_NS, _TICK_NS, _LATE_NS = 10**12, 10_000_000, 40_000_000
# of tick and time: the operator as known then, and the heartbeats of the switch
Look = Callable[[int, int], tuple[OperatorView | None, tuple[Beat, ...]]]


class MadeUpHand:
    """Known up to noise (3,) that lasts for some frames, and stated so. noise_m: root mean square distance."""

    def __init__(self, noise_m: float = 0.0, seed: int = 0) -> None:
        self._noise_m, self._rng, self.noise = noise_m, np.random.default_rng(seed), np.zeros(3)

    def view(self, k: int, hand_world: Array, now_ns: int) -> OperatorView:
        """The operator as known at tick `k`, whose hand truly is at (3,)."""
        self.noise = 0.9 * self.noise + np.sqrt((1 - 0.9**2) / 3) * self._noise_m * self._rng.normal(size=3)
        measured_world = hand_world + self.noise + 1e-6 * self._rng.normal(size=3)
        return person_view(measured_world, now_ns, measured_ns=now_ns - _LATE_NS, sigma_m=self._noise_m / np.sqrt(3))


@dataclass(frozen=True, kw_only=True)
class Tick:
    """Both sides after a tick, and what they were before."""

    operator: Operator
    before: Operator
    robot: RobotState
    robot_before: RobotState


def operated(driver: Driver, settings: TeleoperationSettings, ticks: int, look: Look) -> Iterator[Tick]:
    """So many ticks of an operator's side that looks and a robot that follows."""
    operator, robot = Operator(), replace(driver.state, sent_ns=_START_NS)
    for k in range(ticks):
        now_ns = _START_NS + k * _TICK_NS
        view, heartbeats = look(k, now_ns)
        cameras = CameraReport(t_ns=now_ns, healthy=4, total=4)
        news = OperatorNews(view=view, pressed=Pressed(heartbeats=heartbeats), cameras=cameras, robot=robot)
        before, robot_before = operator, robot
        operator, order = step_operator(operator, news, now_ns, settings)
        robot = driver.step([order] if order else [], now_ns)
        yield Tick(operator=operator, before=before, robot=robot, robot_before=robot_before)
