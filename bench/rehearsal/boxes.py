"""The paper's kind of task: boxes moved between marked places by the hand of a made-up operator, in simulated time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array
from posefuse_teleop.follower import Driver
from posefuse_teleop.gate import Beat
from posefuse_teleop.mujoco_robot import MujocoRobot, mobile_manipulator
from posefuse_teleop.settings import MappingSettings, RobotSettings, TeleoperationSettings
from posefuse_teleop.values import OperatorView, Phase

from .figures import lag_and_rms
from .operator import RATE_HZ, MadeUpHand, operated
from .robots import with_joints

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
# the switch is pressed so many ticks before the hand moves
_PRESSED = 70
SETTINGS = TeleoperationSettings(mapping=MappingSettings(scale=SCALE), robot=RobotSettings(position_xy_m=BASE_XY_M))


def scene() -> str:
    """MJCF text of our robot with a table, marks on it, and boxes that can be carried."""
    box_m, lies_m = (_EDGE_M,) * 3, _TABLE_M + _EDGE_M / 2 + 0.001
    things = _thing("table", (0.5, 0.8, _TABLE_M), (0.8, 0.02, _TABLE_M / 2), 'rgba="0.75 0.66 0.52 1"')
    for i, xy in enumerate(MARKS):
        things += _thing(f"mark{i}", (0.1, 0.1, 0.002), (*xy, _TABLE_M), 'rgba="0.2 0.65 0.3 1"')
    for i, xy in enumerate(STARTS):
        carried = 'rgba="0.85 0.35 0.2 1" mass="0.3" friction="1 0.05 0.01"'
        things += _thing(f"box{i}", box_m, (*xy, lies_m), carried, "<freejoint/>")
    free = "".join(f"{x} {y} {lies_m} 1 0 0 0 " for x, y in STARTS)
    return (
        mobile_manipulator(SETTINGS.hands)
        .replace('<body name="base"', things + '<body name="base"')
        .replace('qpos="', f'qpos="{free}')
    )


def _thing(name: str, size_m: tuple[float, ...], xyz_m: tuple[float, ...], about: str, joint: str = "") -> str:
    size, place = (" ".join(f"{one:g}" for one in row) for row in (np.divide(size_m, 2), xyz_m))
    return f'<body name="{name}" pos="{place}">{joint}<geom name="{name}" type="box" size="{size}" {about}/></body>'


@dataclass(frozen=True, eq=False, kw_only=True)
class Script:
    """What the hand does, at 100 Hz.

    Attributes:
        xyz: (T, 3) where the end effector should be, in axes of its base; minimum jerk from point to point.
        grip: (T,) whether the gripper is closed.
    """

    xyz: Array
    grip: Array


def script(start: Array) -> Script:
    """Pick the boxes up one by one and put each down on its mark, with pauses as a careful person makes them."""
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


def move_boxes(hand: MadeUpHand) -> dict[str, float]:
    """Do the task: boxes on their marks of all, seconds, error of the path after one lag, and that lag. hand: as it is known."""
    robot = with_joints(SETTINGS, scene())
    driver, world_from_base = Driver(robot, SETTINGS), robot.joints.world_from_model
    plan, rest = script(world_from_base.inverse() @ driver.state.xyz_world[0]), round(REST_S * RATE_HZ)

    def look(k: int, now_ns: int) -> tuple[OperatorView | None, tuple[Beat, ...]]:
        i = max(0, k - rest)
        beat = Beat(seq=k, sent_ns=now_ns, grip=bool(plan.grip[i]))
        return hand.view(k, HAND_M + (plan.xyz[i] - plan.xyz[0]) / SCALE, now_ns), (beat,) if k > rest - _PRESSED else ()

    done, holds = [], 0
    for tick in operated(driver, SETTINGS, rest + len(plan.xyz), look):
        holds += tick.operator.gate.phase is Phase.HOLD and tick.before.gate.phase is Phase.ENGAGED
        done.append(tick.robot.measured_xyz_world[0])
    lag_s, rms_m = lag_and_rms(world_from_base @ plan.xyz[1:], np.array(done[rest + 1 :]), RATE_HZ)
    moved = {"placed": on_marks(robot), "of": len(MARKS), "seconds": len(plan.xyz) / RATE_HZ}
    return moved | {"path_rms_mm": 1e3 * rms_m, "lag_ms": 1e3 * lag_s, "holds": int(holds)}


def on_marks(robot: MujocoRobot) -> int:
    """How many boxes lie on the table within 3 cm of their marks."""
    found = [(robot.data.body(f"box{i}").xpos, mark) for i, mark in enumerate(MARKS)]
    lie = [abs(xyz[2] - _TABLE_M - _EDGE_M / 2) < 0.01 and np.hypot(*(xyz[:2] - mark)) <= _NEAR_M for xyz, mark in found]
    return int(sum(lie))
