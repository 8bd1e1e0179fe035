"""What is commanded to the joints keeps every limit, whatever is ordered; judged by MuJoCo's own kinematics, apart from ours."""

from dataclasses import replace

import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco")
pytest.importorskip("daqp")

from posefuse.teleoperation.robots.driver import Driver
from posefuse.teleoperation.robots.mujoco_robot import MujocoRobot, mujoco_model
from posefuse.teleoperation.settings import LimitSettings, RobotSettings, TeleoperationSettings
from posefuse.teleoperation.values import Order, Phase

DT_S, TICK_NS = 0.01, 10_000_000
LIMITS = LimitSettings()


def driven(hands, wishes, limits=LIMITS, model=None):
    """(T, J) joints and (T, H, 3) end effectors of what is commanded while the targets are `wishes` from the start position.

    A wish is (H, 3) metres from the start, or None: no order comes.
    """
    settings = TeleoperationSettings(hands=hands, limits=limits, robot=RobotSettings(shared=False))
    robot = MujocoRobot(model or mujoco_model(None, hands), [f"{side}_hand" for side in hands], limits)
    driver, now_ns, q = Driver(robot, settings), 10**12, []
    start, turned = driver.posture.xyz_world, driver.posture.wxyz
    for seq, wish in enumerate(wishes):
        now_ns += TICK_NS
        orders = []
        if wish is not None:
            target = driver.follower.xyz + np.clip(start + wish - driver.follower.xyz, -0.15, 0.15)
            orders = [order(seq, now_ns, target, turned)]
        driver.step(orders, now_ns)
        q.append(driver.posture.q)
    return robot, np.array(q), ends_of(robot, np.array(q))


def order(seq, now_ns, xyz, wxyz):
    return Order(
        seq=seq,
        sent_ns=now_ns,
        phase=Phase.ENGAGED,
        xyz_world=xyz,
        wxyz=wxyz,
        speed_mps=LIMITS.speed_mps,
        grip=np.zeros(len(xyz), bool),
    )


def ends_of(robot, q):
    chain, data = robot.joints.chain, mujoco.MjData(robot.model)
    sites, found = [robot.model.site(f"{side}_hand").id for side in ("right", "left")[: chain.hands]], []
    for one in q:
        data.qpos[chain.qpos] = one
        mujoco.mj_kinematics(robot.model, data)
        found.append(data.site_xpos[sites].copy())
    return np.array(found)


def random_wishes(rng, hands, steps=400):
    """Targets that jump to places within and out of reach, and times without any order."""
    wish, found = np.zeros((hands, 3)), []
    for _ in range(steps):
        if rng.random() < 0.02:
            wish = rng.normal(size=(hands, 3)) * rng.choice([0.05, 0.3, 1.5])
        found.append(wish)
    for _ in range(3):
        begin = rng.integers(0, steps - 60)
        found[begin : begin + 40] = [None] * 40
    return found


def most(vectors):
    return float(np.linalg.norm(vectors, axis=-1).max())


@pytest.mark.parametrize("hands", (("right",), ("right", "left")), ids=len)
@pytest.mark.parametrize("seed", range(3))
def test_joints_and_end_effectors_keep_every_limit(hands, seed):
    robot, q, xyz = driven(hands, random_wishes(np.random.default_rng([seed, 5]), len(hands)))
    chain, arm = robot.joints.chain, robot.joints.chain.arm
    speed, acceleration = np.diff(q, axis=0) / DT_S, np.diff(q, n=2, axis=0) / DT_S**2
    assert np.abs(speed[:, arm]).max() <= LIMITS.joint_speed_radps * (1 + 1e-9)
    assert np.abs(speed[:, ~arm]).max() <= LIMITS.base_speed_mps * (1 + 1e-9)
    assert np.abs(acceleration[:, arm]).max() <= LIMITS.joint_acceleration_radps2 * (1 + 1e-9)
    assert np.abs(acceleration[:, ~arm]).max() <= LIMITS.base_acceleration_mps2 * (1 + 1e-9)
    margin = np.where(arm, LIMITS.joint_margin_rad, 0.0)
    assert (q >= chain.low + margin - 1e-9).all() and (q <= chain.high - margin + 1e-9).all()
    assert most(np.diff(xyz, axis=0)) / DT_S <= LIMITS.speed_mps * (1 + 1e-9)
    assert most(np.diff(xyz, n=2, axis=0)) / DT_S**2 <= LIMITS.acceleration_mps2 * (1 + 1e-9)
    print(np.ptp(xyz, axis=0), np.linalg.norm(np.diff(xyz,axis=0),axis=-1).sum(axis=0))
