"""All that is true in one sequence of faults, and what each side knows of it."""

from __future__ import annotations

from collections import deque
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from posefuse.core.arrays import Array
from posefuse.teleoperation.operator import Operator
from posefuse.teleoperation.robots.driver import Driver
from posefuse.teleoperation.settings import TeleoperationSettings
from posefuse.teleoperation.values import Order, RobotState

from .person import sine
from .robot import ExactRobot

TICK_S = 0.01
_START_NS = 10**13
# the paths of hands begin with a second of acceleration, which is over when sequences begin
_PATH_S = 2.0


@dataclass(eq=False)
class World:
    """All that is true in one sequence, and what each side knows of it."""

    settings: TeleoperationSettings
    rng: np.random.Generator
    operator: Operator = field(default_factory=Operator)
    robot: ExactRobot = field(default_factory=lambda: ExactRobot(np.array([1.9, -0.2, 0.9])))
    t_s: float = 0.0
    seq: int = 0
    walked_m: float = 0.0

    def __post_init__(self) -> None:
        self.driver = Driver(self.robot, self.settings)
        self.state: RobotState | None = self.driver.state(self.now_ns)
        self.waiting: deque[tuple[float, Order]] = deque()
        self.frozen: Any = None
        self.clock_ns = 0
        self.reached_s = 0.0
        self.left_out = 0
        self._path = sine(float(self.rng.uniform(0.2, 0.9)), period_s=float(self.rng.uniform(1.5, 4.0)))

    def hand(self, t_s: float) -> Array:
        """(3,) where the hand truly is."""
        return self._path(t_s + _PATH_S)

    def copied(self, rng: np.random.Generator) -> World:
        """The same world, to go another way."""
        other = copy(self)
        other.rng, other.waiting, other.robot = rng, self.waiting.copy(), copy(self.robot)
        other.driver = self.driver.copied(other.robot)
        return other

    @property
    def now_ns(self) -> int:
        """True time."""
        return _START_NS + round(self.t_s * 1e9)

    @property
    def shift_m(self) -> Array:
        """(3,) how far the operator has walked."""
        return np.array([self.walked_m, 0.0, 0.0])
