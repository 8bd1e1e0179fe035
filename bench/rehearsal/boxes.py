"""The paper's kind of task: boxes moved between marked places by the hand of a made-up operator, in simulated time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from posefuse.core.arrays import Array
from posefuse_teleop.follower import Driver
from posefuse_teleop.gate import Beat
from posefuse_teleop.mujoco_robot import MujocoRobot, Thing, mobile_manipulator, mujoco_model, placed
from posefuse_teleop.session import Operator, OperatorNews, step_operator
from posefuse_teleop.settings import MappingSettings, RobotSettings, TeleoperationSettings
from posefuse_teleop.values import CameraReport, OperatorView, Phase

from .figures import lag_and_rms
from .person import person_view

RATE_HZ = 100.0
_EDGE_M, _TABLE_M = 0.06, 0.40
_TOP_M = _TABLE_M + _EDGE_M
# where the robot stands; the operator stands at the origin
BASE_XY_M = (2.2, 0.0)
STARTS = ((0.66, -0.22), (0.66, 0.0), (0.66, 0.22))
MARKS = ((0.86, -0.12), (0.86, 0.06), (0.86, 0.24))
_NEAR_M = 0.03
_LIFT_M, _PRESS_M, _SPEED_MPS, _WAIT_S = 0.12, 0.004, 0.2, 0.5
# where the hand begins, metres of the robot per metre of the hand: an arm of 54 cm reaches all of the task so; and how long the
# hand rests before it moves
HAND_M, SCALE = np.array([0.16, -0.22, 1.42]), 1.25
REST_S = 1.0
_TICK_NS = 10_000_000
# the switch is pressed so many ticks before the hand moves
_PRESSED = 70


def things() -> list[Thing]:
    """A table, marks on it, and boxes."""
    table = Thing(name="table", size_m=(0.5, 0.8, _TABLE_M), xyz_m=(0.8, 0.02, _TABLE_M / 2), rgba="0.75 0.66 0.52 1")
    marks = [
        Thing(name=f"mark{i}", size_m=(0.1, 0.1, 0.002), xyz_m=(x, y, _TABLE_M), rgba="0.2 0.65 0.3 1")
        for i, (x, y) in enumerate(MARKS)
    ]
    boxes = [
        Thing(
            name=f"box{i}",
            size_m=(_EDGE_M,) * 3,
            xyz_m=(x, y, _TABLE_M + _EDGE_M / 2 + 0.001),
            rgba="0.85 0.35 0.2 1",
            moves=True,
        )
        for i, (x, y) in enumerate(STARTS)
    ]
    return [table, *marks, *boxes]


@dataclass(frozen=True, eq=False, kw_only=True)
class Script:
    """What the hand does, at 100 Hz.

    Attributes:
        xyz: (T, 3) where the end effector should be, in axes of its base. grip: (T,) whether the gripper is closed.
        at_s, places: (N,), (N, 3) the points between which it moves, with minimum jerk.
    """

    xyz: Array
    grip: Array
    at_s: Array
    places: Array


def script(start: Array, boxes: int = len(STARTS)) -> Script:
    """Pick the first boxes up one by one and put each down on its mark, with pauses as a careful person makes them."""
    legs: list[tuple[Array, bool]] = []
    for (x0, y0), (x1, y1) in list(zip(STARTS, MARKS, strict=True))[:boxes]:
        for x, y, closes in ((x0, y0, True), (x1, y1, False)):
            above, on = np.array([x, y, _TOP_M + _LIFT_M]), np.array([x, y, _TOP_M - _PRESS_M])
            legs += [(above, not closes), (on, not closes), (on, closes), (above, closes)]
    here, xyz, grip = np.array(start), [], []
    at_s, places = [0.0], [here]
    for place, closed in legs:
        far = float(np.linalg.norm(place - here))
        # a minimum-jerk movement is 1.875 times as fast in its middle as on average
        n = round(max(1.875 * far / _SPEED_MPS, _WAIT_S) * RATE_HZ)
        part = np.linspace(0, 1, n, endpoint=False)[:, None]
        xyz.append(here + (part**3 * (10 - 15 * part + 6 * part**2)) * (place - here))
        grip.append(np.full(n, closed))
        here = place
        at_s.append(at_s[-1] + n / RATE_HZ)
        places.append(here)
    return Script(
        xyz=np.concatenate([*xyz, [here]]),
        grip=np.concatenate([*grip, [False]]),
        at_s=np.array(at_s),
        places=np.array(places),
    )


class Hand(Protocol):
    """How the robot's side learns where the hand is."""

    def view(self, k: int, hand_world: Array, now_ns: int) -> OperatorView | None:
        """The operator as known at tick `k`, whose hand truly is at (3,); None: not yet."""
        ...


class MadeUpHand:
    """Known up to noise that lasts for some frames, and stated so. noise_m: root mean square distance."""

    def __init__(self, noise_m: float = 0.0, seed: int = 0) -> None:
        self._noise_m, self._rng, self._noise = noise_m, np.random.default_rng(seed), np.zeros(3)

    def view(self, k: int, hand_world: Array, now_ns: int) -> OperatorView:
        """See `Hand`."""
        self._noise = 0.9 * self._noise + np.sqrt((1 - 0.9**2) / 3) * self._noise_m * self._rng.normal(size=3)
        measured_world = hand_world + self._noise + 1e-6 * self._rng.normal(size=3)
        return person_view(measured_world, now_ns, measured_ns=now_ns - 40_000_000, sigma_m=self._noise_m / np.sqrt(3))


@dataclass(frozen=True, kw_only=True)
class Result:
    """The result of it: boxes on their marks of all, seconds, error of the path after one lag, m, and that lag, s."""

    placed: int
    of: int
    seconds: float
    path_rms_m: float
    lag_s: float
    holds: int


Watch = Callable[[MujocoRobot, OperatorView, Operator, float], None]


@dataclass(eq=False)
class BoxStage:
    """Robot, table and boxes; `plan` counts from where the end effector begins."""

    robot: MujocoRobot
    driver: Driver
    settings: TeleoperationSettings
    plan: Script

    @staticmethod
    def built(boxes: int = len(STARTS)) -> BoxStage:
        """With a task of the first `boxes`."""
        settings = TeleoperationSettings(mapping=MappingSettings(scale=SCALE), robot=RobotSettings(position_xy_m=BASE_XY_M))
        place = placed(settings.robot.position_xy_m, settings.robot.heading_deg)
        model = mujoco_model(None, settings.hands, mobile_manipulator(settings.hands, things()))
        robot = MujocoRobot(model, ["right_hand"], settings.limits, place)
        driver = Driver(robot, settings)
        return BoxStage(robot, driver, settings, script(place.inverse() @ driver.state.xyz_world[0], boxes))

    def hand_path(self, begin_s: float) -> tuple[Array, Array]:
        """(N,) s and (N, 3) m in the world: the points between which the operator's hand moves, after a rest of `begin_s`."""
        return begin_s + self.plan.at_s, HAND_M + (self.plan.places - self.plan.places[0]) / SCALE


def move_boxes(
    hand: Hand | None = None,
    watch: Watch | None = None,
    seconds: float = float("inf"),
    *,
    boxes: int = len(STARTS),
    begin_s: float = REST_S,
) -> Result:
    """Do the task, or its first seconds.

    Args:
        hand: as the robot's side knows it; None: exactly. watch: is shown every step.
        boxes: how many are moved. begin_s: the hand rests so long before.
    """
    stage = BoxStage.built(boxes)
    hand = hand or MadeUpHand()
    settings, plan, driver = stage.settings, stage.plan, stage.driver
    place = placed(settings.robot.position_xy_m, settings.robot.heading_deg)
    operator, state = Operator(), replace(driver.state, sent_ns=10**12)
    wanted: list[Array] = []
    done: list[Array] = []
    holds = 0
    rest = round(begin_s * RATE_HZ)
    steps = min(rest + len(plan.xyz), int(min(seconds, 1e6) * RATE_HZ))
    for k in range(steps):
        now_ns, i = 10**12 + k * _TICK_NS, max(0, k - rest)
        view = hand.view(k, HAND_M + (plan.xyz[i] - plan.xyz[0]) / SCALE, now_ns)
        heartbeats = (Beat(seq=k, sent_ns=now_ns, grip=bool(plan.grip[i])),) if k > rest - _PRESSED else ()
        news = OperatorNews(view=view, heartbeats=heartbeats, cameras=CameraReport(t_ns=now_ns, healthy=4, total=4), robot=state)
        before = operator.gate.phase
        operator, order = step_operator(operator, news, now_ns, settings)
        holds += operator.gate.phase is Phase.HOLD and before is Phase.ENGAGED
        state = driver.step([order] if order else [], now_ns)
        if i:
            wanted.append(place @ plan.xyz[i])
            done.append(state.measured_xyz_world[0])
        if watch is not None and operator.view is not None:
            watch(stage.robot, operator.view, operator, k / RATE_HZ)
    lag_s, rms_m = lag_and_rms(np.array(wanted), np.array(done), RATE_HZ)
    return Result(
        placed=_on_marks(stage.robot, boxes),
        of=boxes,
        seconds=len(plan.xyz) / RATE_HZ,
        path_rms_m=rms_m,
        lag_s=lag_s,
        holds=holds,
    )


def _on_marks(robot: MujocoRobot, boxes: int) -> int:
    """How many of the first boxes lie on the table within 3 cm of their marks."""
    count = 0
    for i, (x, y) in enumerate(MARKS[:boxes]):
        found = robot.data.body(f"box{i}").xpos
        lies = abs(found[2] - _TABLE_M - _EDGE_M / 2) < 0.01
        count += bool(lies and np.hypot(found[0] - x, found[1] - y) <= _NEAR_M)
    return count
