"""All that is true in one sequence of faults, and what each side knows of it."""

from __future__ import annotations

from collections import deque
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from posefuse.core.arrays import Array
from posefuse_teleop.follower import Driver
from posefuse_teleop.hands import BODY
from posefuse_teleop.session import Operator
from posefuse_teleop.settings import TeleoperationSettings
from posefuse_teleop.values import OperatorView, Order, RobotState

from .person import Build, body_xyz, hidden, sine, view_of, within_reach
from .robots import STANDS, copied

TICK_S = 0.01
_START_NS = 10**13
# the paths of hands begin with a second of acceleration, which is over when sequences begin
_PATH_S = 2.0
# what reaches for the robot with a hand that no camera sees does so with this speed, as far as an arm is long
_REACH_MPS, _REACH_M = 1.5, 0.7


@dataclass(eq=False)
class World:
    """All that is true in one sequence, and what each side knows of it.

    Attributes:
        walked_m: how far the operator has walked to the robot. reached_m: how far the free hand has reached for it.
        build: of the person who is there; another one than the operator's after an exchange, which was at `exchanged_s`.
        gone: keypoints that no camera sees. blocked: the robot does not follow.
    """

    settings: TeleoperationSettings
    rng: np.random.Generator
    robot_name: str = "point"
    operator: Operator = field(default_factory=Operator)
    t_s: float = 0.0
    seq: int = 0
    walked_m: float = 0.0
    reached_m: float = 0.0
    build: Build = field(default_factory=Build)
    exchanged_s: float | None = None
    released_s: float = -1.0
    gone: tuple[int, ...] = ()
    blocked: bool = False

    def __post_init__(self) -> None:
        # a point, or a robot with joints and physics
        self.robot: Any = STANDS[self.robot_name].make(self.settings)
        self.driver = Driver(self.robot, self.settings)
        self.state: RobotState | None = replace(self.driver.state, sent_ns=self.now_ns)
        self.waiting: deque[tuple[float, Order]] = deque()
        self.frozen: Any = None
        self.clock_ns = 0
        self.reached_s = 0.0
        self.left_out = 0
        speeds = self.rng.uniform(0.2, 0.9, size=2)
        periods = self.rng.uniform(1.5, 4.0, size=2)
        self._paths = {
            "right": sine(float(speeds[0]), period_s=float(periods[0])),
            "left": sine(float(speeds[1]), period_s=float(periods[1]), centre=np.array([0.35, 0.25, 1.1])),
        }

    def body(self, t_s: float) -> Array:
        """(K, 3) where every point of the person truly is."""
        hands = {side: within_reach(self._paths[side](t_s + _PATH_S), side) for side in self.settings.hands}
        free = {"right", "left"} - {*hands}
        for side in free:
            # from where it hangs, forward and up
            hangs = body_xyz({})[BODY.index(f"{side}_wrist")]
            reaching = within_reach(hangs + self.reached_m * np.array([0.9, 0.0, 0.4]), side)
            hands |= {side: reaching} if self.reached_m else {}
        return body_xyz(hands, np.array([self.walked_m, 0.0, 0.0]), self.build)

    def step_person(self, walks: bool, reaches: bool) -> None:
        """A tick of a person who walks to the robot, or reaches for it with the free hand."""
        self.walked_m = min(self.walked_m + 1.6 * TICK_S, 1.6) if walks else self.walked_m
        self.reached_m = min(self.reached_m + _REACH_MPS * TICK_S, _REACH_M) if reaches else self.reached_m

    def view(self) -> OperatorView:
        """What cameras and network make of the person 40 ms ago."""
        noise = 1e-4 * self.rng.normal(size=3)
        hands = self.settings.hands
        view = view_of(self.body(self.t_s - 0.04) + noise, self.now_ns, measured_ns=self.now_ns - 40_000_000, hands=hands)
        return hidden(view, self.gone, hands) if self.gone else view

    def idle(self) -> None:
        """A tick without a command: a robot with joints stays at its last one."""
        if hasattr(self.robot, "joints"):
            import mujoco

            mujoco.mj_step(self.robot.model, self.robot.data, round(TICK_S / self.robot.model.opt.timestep))

    def copied(self, rng: np.random.Generator) -> World:
        """The same world, to go another way."""
        other = copy(self)
        other.rng, other.waiting, other.robot = rng, self.waiting.copy(), copied(self.robot)
        other.driver = self.driver.copied(other.robot)
        return other

    @property
    def now_ns(self) -> int:
        """True time."""
        return _START_NS + round(self.t_s * 1e9)


def settings_for(robot_name: str, roomy: bool) -> TeleoperationSettings:
    """Settings of a robot of the bench.

    Args:
        roomy: targets go out of reach, to singular postures and into the robot itself; otherwise the box is so small that the
            hand drives the robot against its walls.
    """
    stand = STANDS[robot_name]
    settings = TeleoperationSettings(hands=stand.hands)
    settings = replace(settings, robot=replace(settings.robot, position_xy_m=stand.position_xy_m, heading_deg=stand.heading_deg))
    if roomy:
        return replace(settings, mapping=replace(settings.mapping, scale=3.0, lead_m=0.3))
    begin = stand.make(settings).state().xyz_world
    low, high = begin.min(axis=0) - [0.2, 0.2, 0.15], begin.max(axis=0) + [0.15, 0.25, 0.15]
    box = {"box_low_m": tuple(map(float, low)), "box_high_m": tuple(map(float, high))}
    return replace(settings, limits=replace(settings.limits, **box))
