"""The paper's kind of task: boxes moved between marked places by the hand of a made-up operator, in simulated time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array
from posefuse.teleoperation.gate import CameraReport
from posefuse.teleoperation.heartbeats import Beat
from posefuse.teleoperation.operator import News, Operator, step
from posefuse.teleoperation.robots.driver import Driver
from posefuse.teleoperation.robots.mobile_manipulator import Thing, mobile_manipulator
from posefuse.teleoperation.robots.mujoco_robot import MujocoRobot, model_of, placed
from posefuse.teleoperation.settings import RobotSettings, TeleoperationSettings
from posefuse.teleoperation.values import OperatorView, Phase

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
_HAND = np.array([0.45, -0.25, 1.15])
_ENGAGE_S = 1.0
_TICK_NS = 10_000_000


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
    """Where the end effector should be, (T, 3) from its start, and whether the gripper is closed (T,), at 100 Hz."""

    xyz: Array
    grip: Array


def script(start: Array) -> Script:
    """Pick every box up and put it down on its mark, with pauses as a careful person makes them."""
    legs: list[tuple[Array, bool]] = []
    for (x0, y0), (x1, y1) in zip(STARTS, MARKS, strict=True):
        for x, y, closes in ((x0, y0, True), (x1, y1, False)):
            above, on = np.array([x, y, _TOP_M + _LIFT_M]), np.array([x, y, _TOP_M - _PRESS_M])
            legs += [(above, not closes), (on, not closes), (on, closes), (above, closes)]
    here, xyz, grip = np.array(start), [], []
    for place, closed in legs:
        far = float(np.linalg.norm(place - here))
        # a minimum-jerk movement is 1.875 times as fast in its middle as on average
        n = round(max(1.875 * far / _SPEED_MPS, _WAIT_S) * RATE_HZ)
        part = np.linspace(0, 1, n, endpoint=False)[:, None]
        xyz.append(here + (part**3 * (10 - 15 * part + 6 * part**2)) * (place - here))
        grip.append(np.full(n, closed))
        here = place
    return Script(xyz=np.concatenate([*xyz, [here]]), grip=np.concatenate([*grip, [False]]))


@dataclass(frozen=True, kw_only=True)
class Result:
    """What came of it: boxes on their marks of all, seconds, error of the path after one lag, m, and that lag, s."""

    placed: int
    of: int
    seconds: float
    path_rms_m: float
    lag_s: float
    holds: int


Watch = Callable[[MujocoRobot, OperatorView, Operator, float], None]


def move_boxes(noise_m: float = 0.0, seed: int = 0, watch: Watch | None = None, seconds: float = float("inf")) -> Result:
    """Do the task, or its first seconds; the hand is known up to noise that lasts for some frames. watch: is shown every step."""
    settings = TeleoperationSettings(robot=RobotSettings(position_xy_m=BASE_XY_M))
    place = placed(settings.robot.position_xy_m, settings.robot.heading_deg)
    robot = MujocoRobot(
        model_of(None, settings.hands, mobile_manipulator(settings.hands, things())), ["right_hand"], settings.limits, place
    )
    driver, operator, rng = Driver(robot, settings), Operator(), np.random.default_rng(seed)
    begin = place.inverse() @ driver.posture.xyz_world[0]
    plan, state, noise = script(begin), driver.state(10**12), np.zeros(3)
    wanted: list[Array] = []
    done: list[Array] = []
    holds = 0
    steps = min(round(_ENGAGE_S * RATE_HZ) + len(plan.xyz), int(min(seconds, 1e6) * RATE_HZ))
    for k in range(steps):
        now_ns, i = 10**12 + k * _TICK_NS, max(0, k - round(_ENGAGE_S * RATE_HZ))
        noise = 0.9 * noise + np.sqrt((1 - 0.9**2) / 3) * noise_m * rng.normal(size=3)
        view = person_view(
            _HAND + plan.xyz[i] - begin + noise + 1e-6 * rng.normal(size=3),
            now_ns,
            measured_ns=now_ns - 40_000_000,
            sigma_m=noise_m / np.sqrt(3),
        )
        beats = (Beat(seq=k, sent_ns=now_ns, grip=bool(plan.grip[i])),) if k > 30 else ()
        news = News(view=view, beats=beats, cameras=CameraReport(t_ns=now_ns, healthy=4, total=4), robot=state)
        before = operator.gate.phase
        operator, order = step(operator, news, now_ns, settings)
        holds += operator.gate.phase is Phase.HOLD and before is Phase.ENGAGED
        state = driver.step([order] if order else [], now_ns)
        if i:
            wanted.append(place @ plan.xyz[i])
            done.append(state.measured_xyz_world[0])
        if watch is not None:
            watch(robot, view, operator, k / RATE_HZ)
    lag_s, rms_m = lag_and_rms(np.array(wanted), np.array(done), RATE_HZ)
    return Result(
        placed=_on_marks(robot), of=len(MARKS), seconds=len(plan.xyz) / RATE_HZ, path_rms_m=rms_m, lag_s=lag_s, holds=holds
    )


def _on_marks(robot: MujocoRobot) -> int:
    """How many boxes lie on the table within 3 cm of their marks."""
    count = 0
    for i, (x, y) in enumerate(MARKS):
        found = robot.data.body(f"box{i}").xpos
        lies = abs(found[2] - _TABLE_M - _EDGE_M / 2) < 0.01
        count += bool(lies and np.hypot(found[0] - x, found[1] - y) <= _NEAR_M)
    return count
