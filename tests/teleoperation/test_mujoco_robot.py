"""The simulated robot: inverse kinematics against MuJoCo's own kinematics, limits of its joints, and no step when it engages."""

from dataclasses import replace

import numpy as np
import pytest
from commanded import commanded, order

pytest.importorskip("mujoco")
pytest.importorskip("daqp")

from posefuse.core import ConfigError
from posefuse_teleop.follower import Driver
from posefuse_teleop.mujoco_robot import MujocoRobot, mobile_manipulator, mujoco_model, placed
from posefuse_teleop.settings import LimitSettings, TeleoperationSettings

LIMITS = LimitSettings()
DT_S = 0.01


def robot(hands=("right",), place=None):
    return MujocoRobot(mujoco_model(None, hands), [f"{side}_hand" for side in hands], LIMITS, place)


def drive(made, xyz, wxyz=None, stands=False):
    """One control step; how far the commanded end effectors are from the goal then, m."""
    wxyz = made.state().wxyz if wxyz is None else wxyz
    speed = 0.0 if stands else 0.1
    made.move(commanded(np.atleast_2d(xyz), wxyz, (speed, speed, speed), brakes=stands), DT_S)
    return float(np.linalg.norm(made.state().xyz_world - xyz, axis=1).max())


def test_jacobians_agree_with_finite_differences():
    chain = robot().joints.chain
    rng = np.random.default_rng(0)
    q = chain.home + 0.2 * rng.normal(size=len(chain.home))
    chain.place(q)
    jacobian = chain.jacobians()[0, :3]
    numeric = []
    for step in 1e-6 * np.eye(len(q)):
        chain.place(q + step)
        ahead = chain.positions()[0]
        chain.place(q - step)
        numeric.append((ahead - chain.positions()[0]) / 2e-6)
    assert jacobian == pytest.approx(np.array(numeric).T, abs=1e-6)


def test_a_path_is_followed_by_joints_within_their_limits():
    made = robot(place=placed((2.0, 1.0), 30.0))
    start, wxyz, q = made.state().xyz_world, made.state().wxyz, made.state().q_rad
    errors, steps = [], []
    for k in range(400):
        t = k * DT_S
        part = min(1.0, t / 2)
        ease = part**3 * (10 - 15 * part + 6 * part**2)
        wanted = start + ease * np.array([[0.15 * np.sin(1.5 * t), 0.2 * np.sin(t), 0.1 * np.sin(2 * t)]])
        errors.append(drive(made, wanted, wxyz))
        after = made.state()
        steps.append(np.abs(after.q_rad - q).max())
        q = after.q_rad
    assert max(errors) < 1e-5 and max(steps) <= LIMITS.joint_speed_radps * DT_S + 1e-9
    # the physics follow the commanded joints; 0.3 m/s here
    assert np.linalg.norm(made.state().measured_xyz_world - made.state().xyz_world) < 5e-3


def test_the_arm_moves_first_and_the_base_when_it_is_stretched():
    made = robot()
    start = made.state().xyz_world
    for k in range(50):
        drive(made, start + [[0.001 * k, 0, 0]])
    assert np.abs(made.joints.q[:3]).max() < 1e-9
    errors = [drive(made, start + [[0.05 + 0.002 * k, 0, 0]]) for k in range(600)]
    assert errors[-1] < 1e-3 and made.joints.q[0] > 0.5


def test_a_base_that_is_held_is_a_fault():
    """No joint of the arm shows it."""
    made = robot()
    start, chain = made.state().xyz_world, made.joints.chain
    held = made.data.qpos[chain.qpos[0]]
    for k in range(400):
        drive(made, start + [[0.05 + 0.002 * k, 0, 0]])
        made.data.qpos[chain.qpos[0]], made.data.qvel[chain.dofs[0]] = held, 0.0
        chain.place(made.data.qpos[chain.qpos])
        apart_m = np.linalg.norm(chain.positions() - made.state().xyz_world)
    assert apart_m > 0.15 and made.state().fault == f"the end effector is {apart_m:.2f} m from where it was commanded"


def test_what_cannot_be_reached_is_reported_and_joint_limits_are_kept():
    made = robot()
    driver, chain, now_ns = Driver(made, TeleoperationSettings()), made.joints.chain, 10**12
    start, state = made.state(), replace(driver.state, sent_ns=now_ns)
    for k in range(400):
        now_ns += 10_000_000
        target = start.xyz_world + [[0, 0, min(0.003 * k, 0.9)]]
        near = driver.follower.xyz + np.clip(target - driver.follower.xyz, -0.1, 0.1)
        state = driver.step([order(k, now_ns, near, start.wxyz)], now_ns)
        assert k > 100 or not state.limited
    assert state.limited == "the joints cannot follow"
    # what is reported as commanded is where the joints are
    assert np.array_equal(state.xyz_world, made.state().xyz_world)
    inside = (made.joints.q >= chain.low + LIMITS.joint_margin_rad - 1e-9) & (
        made.joints.q <= chain.high - LIMITS.joint_margin_rad + 1e-9
    )
    assert inside[chain.arm].all()


def test_the_arm_does_not_go_into_its_own_base_or_the_floor():
    made = robot()
    start = made.state().xyz_world
    for way in ([-0.003, 0, -0.002], [0, 0, -0.004]):
        made = robot()
        for k in range(250):
            drive(made, start + k * np.array([way]))
            made.data.ncon == 0 or pytest.fail(f"contact on the way {way}")


def test_standing_is_standing_to_the_last_bit():
    made = robot()
    q = made.state().q_rad.copy()
    for _ in range(50):
        drive(made, made.state().xyz_world, stands=True)
    assert np.array_equal(made.state().q_rad, q)
    assert np.linalg.norm(made.state().measured_xyz_world - made.state().xyz_world) < 1e-3


def test_two_arms_share_a_base():
    made = robot(("right", "left"))
    start = made.state().xyz_world
    errors = [drive(made, start + 0.0008 * k * np.array([[1.0, -0.3, 0.2], [1.0, 0.3, -0.1]])) for k in range(150)]
    assert np.abs(made.state().xyz_world - start).max() > 0.1 and errors[-1] < 1e-3


def test_spheres_cover_every_geom():
    import mujoco

    made = robot()
    spheres, model, data = made.state().spheres_world, made.model, made.data
    rng = np.random.default_rng(0)
    for g in range(model.ngeom):
        if int(model.geom_bodyid[g]) not in made.joints.chain.bodies:
            continue
        size = model.geom_size[g]
        if int(model.geom_type[g]) == int(mujoco.mjtGeom.mjGEOM_BOX):
            local = rng.choice([-1, 1], size=(40, 3)) * size
        else:
            turn = rng.uniform(0, 2 * np.pi, 40)
            local = np.stack([size[0] * np.cos(turn), size[0] * np.sin(turn), rng.uniform(-1, 1, 40) * size[1]], axis=1)
        surface = data.geom_xpos[g] + local @ data.geom_xmat[g].reshape(3, 3).T
        inside = np.linalg.norm(surface[:, None] - spheres[None, :, :3], axis=-1) <= spheres[None, :, 3] + 1e-6
        assert inside.any(axis=1).all(), model.geom(g).name


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("right_hand", "tool"), "no site 'right_hand'"),
        (('<position name="right_j3"', '<motor name="right_j3"'), "not a usable MJCF"),
        (
            ('<position name="right_j3" joint="right_j3" kp="5000" dampratio="1"/>', '<motor joint="right_j3"/>'),
            "expected <position>",
        ),
        (('<position name="right_j3" joint="right_j3" kp="5000" dampratio="1"/>', ""), "has no actuator"),
    ],
)
def test_a_model_that_cannot_be_driven_is_refused_in_one_line(tmp_path, change, words):
    file = tmp_path / "robot.xml"
    text = mobile_manipulator().replace(*change)
    file.write_text(text[: text.index("<keyframe>")] + "</mujoco>")
    with pytest.raises(ConfigError, match=words) as refused:
        MujocoRobot(mujoco_model(file, ("right",)), ["right_hand"], LIMITS)
    assert "\n" not in str(refused.value)


def test_a_base_that_floats_is_refused(tmp_path):
    file = tmp_path / "robot.xml"
    body = '<body><freejoint/><geom size="0.1"/><site name="right_hand"/></body>'
    file.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    with pytest.raises(ConfigError, match="free base"):
        MujocoRobot(mujoco_model(file, ("right",)), ["right_hand"], LIMITS)
