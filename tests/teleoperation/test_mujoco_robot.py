"""The simulated robot: inverse kinematics against MuJoCo's own kinematics, limits of its joints, and no step when it engages."""

from dataclasses import replace

import numpy as np
import pytest
from checks import refusal
from commanded import commanded, order

pytest.importorskip("mujoco")
pytest.importorskip("daqp")

import mujoco

from bench.rehearsal.judge import pairs_apart
from posefuse.core import ConfigError
from posefuse_teleop.follower import Driver
from posefuse_teleop.mujoco_robot import MujocoRobot, mobile_manipulator, mujoco_model, placed
from posefuse_teleop.settings import LimitSettings, RobotSettings, TeleoperationSettings

LIMITS = LimitSettings()
DT_S, TICK_NS = 0.01, 10_000_000


def robot(hands=("right",), place=None, limits=LIMITS, model=None):
    return MujocoRobot(model or mujoco_model(None, hands), [f"{side}_hand" for side in hands], limits, place)


def drive(made, xyz, wxyz=None, stands=False):
    """One control step; how far the commanded end effectors are from the goal then, m."""
    wxyz = made.state().wxyz if wxyz is None else wxyz
    speed = 0.0 if stands else 0.1
    made.move(commanded(np.atleast_2d(xyz), wxyz, (speed, speed, speed), brakes=stands), DT_S)
    return float(np.linalg.norm(made.state().xyz_world - xyz, axis=1).max())


def test_jacobians_agree_with_finite_differences():
    chain = robot().joints.chain
    q = chain.home + 0.2 * np.random.default_rng(0).normal(size=len(chain.home))

    def position(q):
        chain.place(q)
        return chain.positions()[0].copy()

    numeric = [(position(q + step) - position(q - step)) / 2e-6 for step in 1e-6 * np.eye(len(q))]
    chain.place(q)
    assert chain.jacobians()[0, :3] == pytest.approx(np.array(numeric).T, abs=1e-6)


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


@pytest.mark.parametrize("way", [1.0, -1.0], ids=["stretched", "folded"])
def test_the_arm_moves_first_and_the_base_when_it_is_stretched_or_folded(way):
    made = robot()
    start = made.state().xyz_world
    for k in range(50):
        drive(made, start + [[0.001 * k * way, 0, 0]])
    assert np.abs(made.joints.q[:3]).max() < 1e-9
    errors = [drive(made, start + [[(0.05 + 0.002 * k) * way, 0, 0]]) for k in range(600)]
    # 1.25 m, also where the folded arm has no more room between its own links
    assert errors[-1] < 1e-3 and made.joints.q[0] * way > 0.5


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
        now_ns += TICK_NS
        target = start.xyz_world + [[0, 0, min(0.003 * k, 0.9)]]
        near = driver.follower.xyz + np.clip(target - driver.follower.xyz, -0.1, 0.1)
        state = driver.step([order(k, now_ns, near, start.wxyz)], now_ns)
        assert k > 100 or not state.limited
    assert state.limited == "the joints cannot follow"
    # what is reported as commanded is where the joints are
    assert np.array_equal(state.xyz_world, made.state().xyz_world)
    margin = LIMITS.joint_margin_rad - 1e-9
    assert ((made.joints.q >= chain.low + margin) & (made.joints.q <= chain.high - margin))[chain.arm].all()


@pytest.mark.parametrize("way", [(-0.003, 0, -0.002), (0, 0, -0.004)], ids=["base", "floor"])
def test_the_arm_does_not_go_into_its_own_base_or_the_floor(way):
    made = robot()
    start = made.state().xyz_world
    for k in range(250):
        drive(made, start + k * np.array([way]))
        assert made.data.ncon == 0


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
    made, rng = robot(), np.random.default_rng(0)
    spheres, model, data = made.state().spheres_world, made.model, made.data
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


DRIVE = '<position name="right_j3" joint="right_j3" kp="5000" dampratio="1"/>'
OWN = mobile_manipulator().partition("<keyframe>")[0] + "</mujoco>"
FLOATS = '<mujoco><worldbody><body><freejoint/><geom size="0.1"/><site name="right_hand"/></body></worldbody></mujoco>'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (OWN.replace("right_hand", "tool"), "no site 'right_hand'"),
        (OWN.replace('<position name="right_j3"', '<motor name="right_j3"'), "not a usable MJCF"),
        (OWN.replace(DRIVE, '<motor joint="right_j3"/>'), "expected <position>"),
        (OWN.replace(DRIVE, ""), "has no actuator"),
        (FLOATS, "free base"),
    ],
    ids=["no site", "no MJCF", "a motor", "no actuator", "floats"],
)
def test_a_model_that_cannot_be_driven_is_refused_in_one_line(tmp_path, text, words):
    file = tmp_path / "robot.xml"
    file.write_text(text)
    refusal(ConfigError, words, lambda: robot(model=mujoco_model(file, ("right",))))


# --- what is commanded to the joints keeps every limit, whatever is ordered; judged by MuJoCo's own kinematics, apart from ours


def driven(hands, wishes, limits=LIMITS, model=None):
    """(T, J) joints and (T, H, 3) end effectors of what is commanded while the targets are `wishes` from the start position.

    A wish is (H, 3) metres from the start, or None: no order comes.
    """
    settings = TeleoperationSettings(hands=hands, limits=limits, robot=RobotSettings(shared=False))
    made = robot(hands, limits=limits, model=model)
    driver, now_ns, q = Driver(made, settings), 10**12, []
    start, turned = driver.state.xyz_world, driver.state.wxyz
    for seq, wish in enumerate(wishes):
        now_ns += TICK_NS
        orders = []
        if wish is not None:
            target = driver.follower.xyz + np.clip(start + wish - driver.follower.xyz, -0.15, 0.15)
            orders = [order(seq, now_ns, target, turned, speed_mps=LIMITS.speed_mps)]
        driver.step(orders, now_ns)
        q.append(driver.state.q_rad)
    return made, np.array(q), ends_of(made, np.array(q))


def ends_of(made, q):
    chain, data = made.joints.chain, mujoco.MjData(made.model)
    sites, found = [made.model.site(f"{side}_hand").id for side in ("right", "left")[: chain.hands]], []
    for one in q:
        data.qpos[chain.qpos] = one
        mujoco.mj_kinematics(made.model, data)
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


def assert_ends_keep_their_limits(xyz):
    """(T, H, 3) end effectors."""
    assert most(np.diff(xyz, axis=0)) / DT_S <= LIMITS.speed_mps * (1 + 1e-9)
    assert most(np.diff(xyz, n=2, axis=0)) / DT_S**2 <= LIMITS.acceleration_mps2 * (1 + 1e-9)


@pytest.mark.parametrize("hands", (("right",), ("right", "left")), ids=len)
@pytest.mark.parametrize("seed", range(3))
def test_joints_and_end_effectors_keep_every_limit(hands, seed):
    made, q, xyz = driven(hands, random_wishes(np.random.default_rng([seed, 5]), len(hands)))
    chain = made.joints.chain
    of_arm = (LIMITS.joint_speed_radps, LIMITS.joint_acceleration_radps2, LIMITS.joint_margin_rad)
    of_base = (LIMITS.base_speed_mps, LIMITS.base_acceleration_mps2, 0.0)
    speed, acceleration, margin = np.where(chain.arm[:, None], of_arm, of_base).T
    assert (np.abs(np.diff(q, axis=0)) / DT_S <= speed * (1 + 1e-9)).all()
    assert (np.abs(np.diff(q, n=2, axis=0)) / DT_S**2 <= acceleration * (1 + 1e-9)).all()
    assert (q >= chain.low + margin - 1e-9).all() and (q <= chain.high - margin + 1e-9).all()
    assert_ends_keep_their_limits(xyz)
    assert np.ptp(xyz, axis=0).max() > 0.2  # it does move


@pytest.mark.parametrize("seed", range(2))
def test_no_limit_depends_on_what_the_inverse_kinematics_finds(seed):
    """One that minds nothing but the joints' own speed and acceleration, and drives them anywhere."""
    rng, made = np.random.default_rng(seed), robot(("right", "left"))
    joints, way = made.joints, np.zeros(17)

    def anywhere(q, last, xyz, wxyz, dt_s):
        change, most_rad = joints.ik.acceleration * dt_s**2, joints.ik.speed * dt_s
        return np.clip(np.clip(way * most_rad, last - change, last + change), -most_rad, most_rad)

    joints.ik.step, q = anywhere, []
    for k in range(300):
        way = rng.uniform(-1, 1, size=17) if k % 60 == 0 else way
        joints.move(made.state().xyz_world, made.state().wxyz, DT_S)
        q.append(joints.q)
    arm = joints.chain.arm
    assert least_m(made, q)[0].min() >= LIMITS.collision_m - 1e-8
    assert_ends_keep_their_limits(ends_of(made, np.array(q)))
    assert (np.array(q)[:, arm] <= joints.ik.high[arm] + 1e-9).all() and (np.array(q)[:, arm] >= joints.ik.low[arm] - 1e-9).all()
    assert np.ptp(q, axis=0).max() > 0.2


def at_speed(rng):
    """Joints of our robot that move as fast as they may."""
    made = robot()
    start, way = made.state(), rng.normal(size=3)
    for k in range(40):
        made.joints.move(start.xyz_world + 0.005 * k * way / np.linalg.norm(way), start.wxyz, DT_S)
    return made


@pytest.mark.parametrize("seed", range(8))
def test_a_late_process_stops_as_soon_and_within_the_limits(seed):
    """Steps that were left out are not made up for: the velocity of the stop falls for them, too."""
    calls = {}
    for left_out in (0, 1):
        made = at_speed(np.random.default_rng(seed))
        q = [made.joints.q - made.joints.step, made.joints.q]
        while np.abs(made.joints.step).max() > 0:
            # late at first only, then in time
            made.joints.brake(DT_S, left_out if len(q) < 6 else 0)
            q.append(made.joints.q)
        calls[left_out] = len(q)
        change = np.diff(ends_of(made, np.array(q)), n=2, axis=0)
        assert most(change[6:]) / DT_S**2 <= LIMITS.acceleration_mps2
    assert calls[1] <= calls[0] - 3


def test_where_a_stop_ends_is_known_before_it():
    """What a trajectory over ROS leads to, in case it is the last."""
    joints = at_speed(np.random.default_rng(3)).joints
    end, steps = joints.resting()
    for _ in range(steps):
        joints.brake(DT_S, 0)
    assert steps > 3
    np.testing.assert_allclose(joints.q, end, atol=1e-12)


def test_no_step_is_taken_after_which_stopping_takes_longer_than_promised():
    """Joints that brake slowly move slowly: the robot stands 0.35 s after the last order, the watchdog included."""
    limits = replace(LIMITS, joint_acceleration_radps2=1.0, base_acceleration_mps2=0.2)
    made = robot(limits=limits)
    start, longest = made.state(), 0
    for k in range(300):
        made.joints.move(start.xyz_world + 0.005 * min(k, 60), start.wxyz, DT_S)
        longest = max(longest, made.joints.resting()[1])
    assert 0.1 < longest * DT_S <= 0.28


def test_each_joint_may_have_its_own_limits():
    speeds, accelerations = (2.0, 0.4, 2.0, 0.5, 2.0, 0.6, 2.0), (8.0, 2.0, 8.0, 3.0, 8.0, 2.5, 8.0)
    limits = replace(LIMITS, joint_speed_radps=speeds, joint_acceleration_radps2=accelerations)
    made, q, _ = driven(("right",), random_wishes(np.random.default_rng(11), 1), limits)
    arm = made.joints.chain.arm
    speed, acceleration = np.abs(np.diff(q[:, arm], axis=0)) / DT_S, np.abs(np.diff(q[:, arm], n=2, axis=0)) / DT_S**2
    assert (speed.max(axis=0) <= np.array(speeds) * (1 + 1e-9)).all() and speed.max(axis=0)[3] > 0.49
    assert (acceleration.max(axis=0) <= np.array(accelerations) * (1 + 1e-9)).all()
    wrong = replace(limits, joint_speed_radps=(1.0, 2.0))
    refusal(ConfigError, "expected one value, or 7 for the joints", robot, limits=wrong)


def least_m(made, q):
    """Least distance of any two bodies of the robot that do not touch by construction, and of any and the floor, over (T, J)."""
    model, chain, found = made.model, made.joints.chain, []
    data = mujoco.MjData(model)
    pairs = pairs_apart(model, data, chain, LIMITS.collision_m, mujoco)
    for one in q:
        data.qpos[chain.qpos] = one
        mujoco.mj_kinematics(model, data)
        found.append([mujoco.mj_geomDistance(model, data, *pair, 1.0, None) for pair in pairs])
    names = [{model.geom(int(g)).name for g in pair} for pair in pairs]
    return np.array(found), names


# how far from the start the hands are sent, and the bodies of which one is in the way
ARMS_AT = {
    "each other": ([0.0, 0.4, 0.0], [0.0, -0.4, 0.0], "left"),
    "each other across": ([0.1, 0.5, -0.1], [-0.1, -0.5, 0.1], "left"),
    "the floor": ([0.1, 0.0, -0.7], [0.1, 0.0, -0.7], "floor"),
    "the base": ([-0.7, 0.0, -0.6], [-0.7, 0.0, -0.6], "base"),
}


@pytest.mark.parametrize("way", ARMS_AT)
def test_two_arms_driven_at_something_keep_their_distance(way):
    right, left, thing = ARMS_AT[way]
    # joints end before a hand reaches the floor on which this robot stands
    text = mobile_manipulator(("right", "left")).replace('name="floor"', f'name="floor" pos="0 0 {0.1 * (thing == "floor")}"')
    model = mujoco_model(None, ("right", "left"), text)
    made, q, _ = driven(("right", "left"), [np.array([right, left])] * 400, replace(LIMITS, box_low_m=(-9, -9, -9)), model)
    found, names = least_m(made, q)
    assert found.min() >= LIMITS.collision_m - 1e-8
    # the right arm does get near to it, so that this is the guard's work; what is near in every pose does not count
    met = [{"right", thing} <= {name.split("_")[0] for name in pair} for pair in names] & (np.ptp(found, axis=0) > 0.1)
    assert found[:, met].min() < LIMITS.collision_m + 0.01


FIXED_ARMS = """<mujoco><compiler angle="radian"/><worldbody><geom name="floor" type="plane" size="3 3 .1"/>
<body name="torso"><geom name="torso" type="box" size=".1 .2 .5" pos="0 0 .5"/>{}{}</body></worldbody>
<actuator>{}</actuator></mujoco>"""


def fixed_arms():
    """Two arms of three joints on a torso that stands in the world."""
    arms, drives = [], ""
    for side, y in (("right", -0.35), ("left", 0.35)):
        text = f'<site name="{side}_hand" pos=".3 0 0"/>'
        for i, axis in reversed(list(enumerate(("0 0 1", "0 1 0", "0 1 0")))):
            place = f"0 {y} 1" if i == 0 else ".3 0 0"
            shape = f'<geom name="{side}{i}" type="capsule" size=".05" fromto="0 0 0 .3 0 0"/>'
            joint = f'<joint name="{side}{i}" type="hinge" axis="{axis}" range="-2.5 2.5" limited="true"/>'
            text = f'<body name="{side}{i}" pos="{place}">{joint}{shape}{text}</body>'
            drives += f'<position name="{side}{i}" joint="{side}{i}" kp="1000"/>'
        arms.append(text)
    return mujoco_model(None, ("right", "left"), FIXED_ARMS.format(*arms, drives))


@pytest.mark.parametrize(
    ("model_of", "watched"),
    [(fixed_arms, {"arms": 9, "torso": 6, "floor": 6}), (lambda: None, {"arms": 64, "torso": 0, "floor": 16})],
    ids=["stands fixed", "our own"],
)
def test_both_arms_are_watched_whole(model_of, watched):
    """All pairs of arm and arm; every link and the torso, the floor."""
    chain = robot(("right", "left"), model=model_of()).joints.chain
    pairs = [" ".join(chain.model.geom(int(g)).name for g in pair) for pair in chain.pairs]
    found = {thing: sum(thing in pair for pair in pairs) for thing in ("torso", "floor")}
    assert {"arms": sum("right" in pair and "left" in pair for pair in pairs), **found} == watched


def test_spheres_are_at_both_arms_and_the_torso():
    spheres = robot(("right", "left"), model=fixed_arms()).state().spheres_world
    assert spheres[:, 1].min() < -0.3 and spheres[:, 1].max() > 0.3 and (np.abs(spheres[:, :2]) < 0.2).all(axis=1).any()


def test_geoms_whose_masks_keep_them_from_touching_are_not_watched():
    model = fixed_arms()
    [first, *_] = [g for g in range(model.ngeom) if "right" in model.geom(g).name]
    model.geom_contype[first], model.geom_conaffinity[first] = 2, 4
    pairs = robot(("right", "left"), model=model).joints.chain.pairs
    assert len(pairs) and first not in pairs


def test_a_pair_that_overlaps_does_not_come_nearer():
    """Where the robot starts overlapping, e.g. by a wrong model, the pair keeps its constraint."""
    made = robot(("right", "left"), model=fixed_arms())
    chain = made.joints.chain
    made.joints.begin(np.array([1.4, 0.0, 0.0, -1.4, 0.0, 0.0]))
    chain.place(made.joints.q)
    before = chain.distances(1.0)
    assert before.min() < 0
    for _ in range(50):
        made.joints.move(made.state().xyz_world + [[0, 0.1, 0], [0, -0.1, 0]], made.state().wxyz, DT_S)
        chain.place(made.joints.q)
    overlapping = before < 0
    assert (chain.distances(1.0)[overlapping] >= before[overlapping] - 1e-6).all()
