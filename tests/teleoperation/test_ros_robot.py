"""Robots over ROS 2: what one that is silent, does not follow or loses its driver is sent, and a node that stands for one."""

import shutil
import signal
import threading
import time
from collections import defaultdict
from contextlib import closing, contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from checks import assert_same, refusal
from commanded import commanded
from own_domain import own_domain
from scipy.interpolate import CubicHermiteSpline

from bench.rehearsal.faults import engaged_world, tick
from bench.rehearsal.world import settings_for
from posefuse.core import SE3, ConfigError, InputError, MessageError, SourceError
from posefuse.foundation.requests_to_end import REQUESTS_TO_END
from posefuse_ros import bags
from posefuse_ros.bags import Recorder, read_mcap
from posefuse_ros.dds import Sample
from posefuse_ros.dds_domain import Network
from posefuse_ros.messages import header, transform
from posefuse_ros.topics import TF, TF_STATIC, Topic
from posefuse_ros.types import decode, encode, message
from posefuse_teleop import process, ros_robot
from posefuse_teleop.kinematics import Chain
from posefuse_teleop.mujoco_robot import ARM_HOME_RAD, mobile_manipulator, mujoco_model
from posefuse_teleop.ros import NAMESPACE, Reporter
from posefuse_teleop.ros_robot import JOINT_STATES, Frames, RosCartesian, RosJoints, open_ros_robot
from posefuse_teleop.settings import LimitSettings, RobotSettings, RosPlan, TeleoperationSettings

DT_S = 0.01
PLAN = RosPlan(network=Network(domain_id=own_domain(), local_only=True), cmd_vel="/cmd_vel")
JOINTS = [f"right_j{i}" for i in range(1, 8)]
PLACE = SE3.from_rotvec([0.0, 0.0, np.pi / 2], [2.0, 0.0, 0.0])


class Node:
    """A node without a network: what others send is put into `inbox`, what the robot sends is in `sent`."""

    def __init__(self):
        self.inbox, self.sent, self.closed = defaultdict(list), [], 0

    def reader(self, topic):
        def take():
            found, self.inbox[topic.name] = self.inbox[topic.name], []
            return found

        return SimpleNamespace(take=take)

    def publish(self, topic, msg, t_ns):
        assert not self.closed
        self.sent.append(msg)

    def close(self):
        self.closed += 1

    def send(self, topic, msg):
        self.inbox[topic].append(Sample(encode(msg), 0))


@pytest.fixture
def clock(monkeypatch):
    """Time of the robot's side; goes on where a test says so."""
    now = SimpleNamespace(s=100.0)
    stand_in = SimpleNamespace(
        monotonic=lambda: now.s, time_ns=lambda: int(now.s * 1e9), sleep=lambda s: setattr(now, "s", now.s + s)
    )
    monkeypatch.setattr(ros_robot, "time", stand_in)
    return now


def tf_message(t_s, *transforms):
    """(parent, child, place) at a time; 0: no stamp."""
    return message("tf2_msgs/msg/TFMessage", transforms=[transform(round(t_s * 1e9), *one) for one in transforms])


def arm(x=0.5, turned_rad=0.0):
    return ("base_link", "elbow", SE3.from_rotvec([0.0, 0.0, turned_rad], [x, 0.0, 0.5])), ("elbow", "tool", SE3.identity())


def cartesian(clock):
    node = Node()
    robot = RosCartesian(node, PLAN, ("tool",), PLACE)
    node.send(TF.name, tf_message(clock.s, *arm()))
    assert robot.known() and not robot.state().fault
    return node, robot


@pytest.mark.parametrize(
    "others",
    [
        pytest.param(lambda t_s: (TF, tf_message(t_s, ("world", "person_7", SE3.identity()))), id="other frames"),
        pytest.param(lambda t_s: (TF, tf_message(100.0, *arm())), id="its last message, repeated"),
        pytest.param(lambda t_s: (TF, tf_message(t_s, ("tool", "camera", SE3.identity()))), id="what is attached to its tool"),
        pytest.param(lambda t_s: (TF, tf_message(t_s, ("odom", "base_link", SE3.identity()))), id="what carries its base"),
        pytest.param(lambda t_s: (TF, tf_message(t_s, arm()[1])), id="a part of its transforms"),
        pytest.param(lambda t_s: (TF_STATIC, tf_message(t_s, *arm())), id="static transforms"),
    ],
)
def test_a_silent_robot_has_a_fault_however_busy_tf_is(clock, others):
    node, robot = cartesian(clock)
    for step in range(21):
        assert step > 19 or not robot.state().fault
        clock.s += DT_S
        topic, msg = others(clock.s)
        node.send(topic.name, msg)
    assert "nothing new of /tf from base_link to tool for 0.2 s" in robot.state().fault
    node.send(TF.name, tf_message(clock.s, *arm()))
    assert not robot.state().fault


def test_messages_without_a_stamp_count_by_their_arrival(clock):
    node, robot = cartesian(clock)
    for _ in range(50):
        clock.s += DT_S
        node.send(TF.name, tf_message(0.0, *arm()))
        assert not robot.state().fault


@pytest.mark.parametrize(("off_s", "fault"), [(0.19, ""), (-0.19, ""), (3.0, "are 3.0 s ahead of"), (-3.0, "are 3.0 s behind")])
@pytest.mark.parametrize("command", ["pose", "joints"])
def test_a_robot_on_another_clock_has_a_fault(clock, jointed, command, off_s, fault):
    """Its controllers judge by their clock how old a command is: one that is behind would follow the last command for as long."""
    node, robot = jointed if command == "joints" else cartesian(clock)
    for _ in range(3):
        clock.s += DT_S
        node.send(TF.name, tf_message(clock.s + off_s, *arm()))
        node.send(JOINT_STATES, joint_state(clock.s + off_s, ARM_HOME_RAD))
        found = robot.state().fault
        assert fault in found and bool(found) == bool(fault)


def test_a_transform_stamped_for_later_shows_no_other_clock(clock):
    node, robot = cartesian(clock)
    node.send(TF.name, tf_message(clock.s + 1.0, arm()[1]))
    assert not robot.state().fault


def test_a_robot_whose_pose_comes_as_static_transforms_only_is_not_known_to_live(clock):
    node = Node()
    robot = RosCartesian(node, PLAN, ("tool",), PLACE)
    node.send(TF_STATIC.name, tf_message(clock.s, *arm()))
    assert robot.known() and "nothing new" in robot.state().fault


def test_the_path_between_two_frames_is_their_own_transforms():
    links = (("map", "base"), ("base", "a"), ("a", "b"), ("base", "c"), ("b", "tool"))
    frames = frames_of(*((*link, SE3.identity()) for link in links))
    assert frames.path("base", "tool") == {"a", "b", "tool"}
    assert frames.path("/c", "/b") == {"c", "a", "b"} and frames.path("a", "a") == set()


@pytest.mark.parametrize(("x", "turned_rad", "fault"), [(0.62, 0.2, False), (0.67, 0.0, True), (0.5, 0.4, True)])
def test_a_pose_that_is_not_followed_is_a_fault(clock, x, turned_rad, fault):
    node, robot = cartesian(clock)
    state = robot.state()
    robot.move(commanded(state.xyz_world, state.wxyz, brakes=True), DT_S)
    node.send(TF.name, tf_message(clock.s, *arm(x, turned_rad)))
    assert bool(robot.state().fault) == fault


def sent_at_the_end(node, robot):
    """Velocities (linear, angular) that a robot gets when it is left, twice."""
    count = len(node.sent)
    robot.close()
    robot.close()
    assert node.closed >= 1
    return [(part.x, part.y, part.z) for msg in node.sent[count:] for part in (msg.twist.linear, msg.twist.angular)]


def test_a_mobile_base_is_left_with_zero_velocity(jointed):
    moving(jointed[1])
    assert sent_at_the_end(*jointed) == [(0.0, 0.0, 0.0)] * 2


@pytest.fixture
def jointed(clock):
    """A mobile manipulator whose arm is driven in its joints."""
    node = Node()
    chain = Chain(mujoco_model(None, ("right",)), ("right_hand",), LimitSettings().collision_m)
    robot = RosJoints(node, PLAN, chain, LimitSettings(), PLACE)
    node.send(JOINT_STATES, joint_state(clock.s, ARM_HOME_RAD))
    assert robot.known() and not robot.state().fault
    return node, robot


def joint_state(t_s, q):
    state, empty = header(round(t_s * 1e9), ""), np.zeros(0)
    known = {"name": JOINTS[: len(q)], "position": np.array(q), "velocity": empty, "effort": empty}
    return message("sensor_msgs/msg/JointState", header=state, **known)


@pytest.mark.parametrize(
    ("others", "fault"),
    [
        pytest.param(lambda t_s: joint_state(t_s, ARM_HOME_RAD), False, id="a robot that reports"),
        pytest.param(lambda t_s: joint_state(0.0, ARM_HOME_RAD), False, id="without a stamp"),
        pytest.param(lambda t_s: joint_state(100.0, ARM_HOME_RAD), True, id="its last message, repeated"),
        pytest.param(lambda t_s: joint_state(t_s, ARM_HOME_RAD[:6]), True, id="a part of its joints"),
        pytest.param(lambda t_s: joint_state(t_s, (*ARM_HOME_RAD[:6], np.nan)), True, id="a joint that is not known"),
    ],
)
def test_only_new_positions_of_all_joints_show_that_it_lives(clock, jointed, others, fault):
    node, robot = jointed
    for _ in range(21):
        clock.s += DT_S
        node.send(JOINT_STATES, others(clock.s))
        robot.state()
    assert bool(robot.state().fault) == fault


def test_the_distance_is_kept_from_where_the_joints_are_and_from_where_they_are_to_be(clock, jointed):
    node, robot = jointed
    before = robot.state().spheres_world
    node.send(JOINT_STATES, joint_state(clock.s + DT_S, np.array(ARM_HOME_RAD) + 0.1))
    state = robot.state()
    assert not state.fault
    apart = np.linalg.norm(state.spheres_world[:, None, :3] - before[None, :, :3], axis=2)
    # all that was covered still is, and the measured arm too
    assert (apart.min(axis=0) < 1e-9).all() and apart.min(axis=1).max() > 0.05
    hand = np.linalg.norm(state.spheres_world[:, :3] - state.measured_xyz_world, axis=1) - state.spheres_world[:, 3]
    assert hand.min() < 0.1


def why_refused(trajectory, now_s):
    """Why a joint_trajectory_controller of ros2_control with its default parameters takes no such trajectory."""
    if not trajectory.points or trajectory.joint_names != JOINTS:
        return "joints"
    ends_s = [point.time_from_start.sec + point.time_from_start.nanosec / 1e9 for point in trajectory.points]
    stamp = trajectory.header.stamp
    if (stamp.sec or stamp.nanosec) and stamp.sec + stamp.nanosec / 1e9 + ends_s[-1] < now_s:
        return "ends in the past"
    if any(end <= before for before, end in zip([0.0, *ends_s], ends_s, strict=False)):
        return "times"
    if any(len(values) != 7 for point in trajectory.points for values in (point.positions, point.velocities)):
        return "sizes"
    if any(len(values) not in (0, 7) for point in trajectory.points for values in (point.accelerations, point.effort)):
        return "sizes"
    # allow_nonzero_velocity_at_trajectory_end is false
    return "velocity at the end" if np.abs(trajectory.points[-1].velocities).max() > 1e-6 else ""


def moving(robot):
    """A robot at speed, and its last trajectory."""
    start = robot.state()
    for k in range(1, 31):
        robot.move(commanded(start.xyz_world + [[0.0, 0.001 * k, 0.0]], start.wxyz, (0.0, 0.1, 0.0)), DT_S)
    return next(msg for msg in robot._node.sent[::-1] if hasattr(msg, "points"))


def test_every_trajectory_is_one_that_a_controller_takes_and_ends_at_rest(clock, jointed):
    node, robot = jointed
    last = moving(robot)
    assert np.abs(last.points[0].velocities).max() > 0.05
    trajectories = [msg for msg in node.sent if hasattr(msg, "points")]
    assert [why_refused(one, clock.s + 0.1) for one in trajectories] == [""] * 30
    for one in trajectories:
        moves, rests, stays = one.points
        assert np.array_equal(rests.positions, stays.positions) and not np.any(stays.velocities)
        # braking along a straight line of joint positions: about the mean of both velocities for the time between them
        seconds = (rests.time_from_start.nanosec - moves.time_from_start.nanosec) / 1e9
        travel, most = rests.positions - moves.positions, moves.velocities * seconds
        share = float(travel @ most / max(most @ most, 1e-12))
        assert travel == pytest.approx(share * most, abs=1e-9) and share + (np.abs(most).max() < 0.003) > 0.1 and share < 0.6
    assert "velocity at the end" in why_refused(message(last.__msgtype__, **{**vars(last), "points": last.points[:1]}), clock.s)


def test_a_trajectory_does_not_brake_beyond_the_joints_limits(jointed):
    """It ends where the checked stop ends, also where the robot is driven against a limit."""
    node, robot = jointed
    chain, start = robot.joints.chain, robot.state()
    for k in range(1, 300):
        robot.move(commanded(start.xyz_world + [[0.0, 0.0, 0.003 * k]], start.wxyz, (0.0, 0.0, 0.3)), DT_S)
    ends = np.array([msg.points[-1].positions for msg in node.sent if hasattr(msg, "points")])
    assert (ends <= chain.high[chain.arm]).all() and (ends >= chain.low[chain.arm]).all()


@pytest.mark.parametrize("brakes", [True, False])
@pytest.mark.parametrize("left_out", [3, 10, 40])
def test_a_process_that_was_stopped_does_not_throw_the_arm_back(jointed, left_out, brakes):
    """The controller is where its last trajectory leads; the next one continues there, as far as it was going."""
    node, robot = jointed
    last = moving(robot)
    times_s = [point.time_from_start.sec + point.time_from_start.nanosec / 1e9 for point in last.points]
    path = CubicHermiteSpline(times_s, [one.positions for one in last.points], [one.velocities for one in last.points])
    here = path(min((left_out + 1) * DT_S, times_s[-1]))
    state = robot.state()
    robot.move(commanded(state.xyz_world, state.wxyz, brakes=brakes), DT_S, left_out)
    first = next(msg for msg in node.sent[::-1] if hasattr(msg, "points")).points[0]
    rates, before = (first.positions - here) / (2 * DT_S), last.points[0].velocities
    share = rates @ before / (before @ before)
    assert -0.05 < share < 1
    np.testing.assert_allclose(rates, share * before, atol=0.02)


def test_a_driver_that_fails_leaves_a_base_without_velocity(jointed, monkeypatch):
    node, robot = jointed
    moving(robot)
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, *REQUESTS_TO_END)}

    def fail(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(process, "built", lambda plan: robot)
    monkeypatch.setattr(process, "_drive", fail)
    try:
        with pytest.raises(ZeroDivisionError):
            process.run_robot(None, process.RobotPlan(settings=TeleoperationSettings()))
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    assert node.closed and node.sent[-1].twist.linear.y == 0.0


def test_a_base_that_no_message_reports_counts_as_where_it_was_driven(jointed):
    _, robot = jointed
    robot.joints.begin(robot.joints.q + np.where(robot.joints.chain.arm, 0.0, 0.2))
    state = robot.state()
    assert state.measured_xyz_world == pytest.approx(state.xyz_world)


# --- where a robot's frame is in the world, by the transforms other nodes publish


def some(seed):
    rng = np.random.default_rng(seed)
    return SE3.from_rotvec(rng.normal(size=3), rng.normal(size=3))


def frames_of(*transforms):
    """(parent, child, place) each."""
    frames = Frames()
    for parent, child, place in transforms:
        frames.add(parent, child, place)
    return frames


def test_a_chain_is_walked_in_both_directions():
    a, b, c = some(1), some(2), some(3)
    frames = frames_of(("map", "world", a), ("map", "odom", b), ("odom", "base", c))
    expected = (b @ c).inverse() @ a
    assert_same(frames.find("base", "world"), expected, 1e-12)
    assert_same(frames.find("world", "base"), expected.inverse(), 1e-12)
    assert_same(frames.find("base", "base"), SE3.identity(), 1e-12)
    assert frames.find("base", "elsewhere") is None
    frames.add("odom", "base", a)
    assert_same(frames.find("odom", "base"), a, 1e-12)


def test_a_circle_of_frames_ends():
    assert frames_of(("a", "b", some(1)), ("b", "a", some(2))).find("world", "a") is None


def test_a_message_is_taken_with_and_without_a_leading_slash():
    frames, place = Frames(), some(3)
    frames.take(transform(0, "/world", "/base", place))
    assert_same(frames.find("world", "base"), place, 1e-12)
    assert_same(frames.find("/base", "world"), place.inverse(), 1e-12)


@pytest.mark.parametrize("wrong", [{"x": float("nan")}, {"w": 0.4}, {}])
def test_a_message_without_a_rotation_is_refused(wrong):
    frames, msg = Frames(), transform(0, "world", "base", some(4))
    msg.transform.rotation = message("geometry_msgs/msg/Quaternion", **({"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0} | wrong))
    refusal(MessageError, "tf of base: expected finite numbers", frames.take, msg)
    assert frames.find("world", "base") is None


# --- over a network, against a node that stands for the robot


SETTINGS = TeleoperationSettings(robot=RobotSettings(position_xy_m=(2.0, 0.0), heading_deg=90.0))


@contextmanager
def robot_node():
    node, ended = PLAN.node("robot"), threading.Event()
    bent = SE3.from_rotvec([0, 0, 0.3], [0.3, 0, 0.5])
    joined = ("base_link", "elbow", bent), ("elbow", "tool", SE3.identity())

    def publish():
        while not ended.wait(0.02):
            t_ns = time.time_ns()
            node.publish(Topic(JOINT_STATES, "sensor_msgs/msg/JointState"), joint_state(t_ns * 1e-9, ARM_HOME_RAD), t_ns)
            node.publish(TF, tf_message(t_ns * 1e-9, *joined), t_ns)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield node
    finally:
        ended.set()
        thread.join(10)
        node.close()


def received(node, topic, act):
    reader = node.reader(topic)
    for _ in range(200):
        act()
        time.sleep(0.02)
        for sample in reader.take():
            return decode(sample.raw, topic.type_name, 10**6)
    pytest.fail(f"nothing on {topic.name}")


def test_a_cartesian_controller_gets_poses_in_its_base_frame():
    with robot_node() as node:
        robot = open_ros_robot("pose", PLAN, None, ("tool",), SETTINGS)
        state = robot.state()
        # the base stands at (2, 0), turned by a quarter
        assert state.xyz_world[0] == pytest.approx([2.0, 0.3, 0.5]) and not state.fault
        topic = Topic(f"{NAMESPACE}/tool/target", "geometry_msgs/msg/PoseStamped", depth=1)
        got = received(node, topic, lambda: robot.move(commanded(state.xyz_world, state.wxyz, (0.0, 0.2, 0.1)), 0.01))
        assert got.header.frame_id == "base_link"
        place = got.pose.position
        assert [place.x, place.y, place.z] == pytest.approx([0.3, 0.0, 0.5])
        robot.close()


def test_joints_of_our_inverse_kinematics_go_to_a_controller(tmp_path):
    file = tmp_path / "robot.xml"
    file.write_text(mobile_manipulator())
    with robot_node() as node:
        robot = open_ros_robot("joints", PLAN, file, ("right_hand",), SETTINGS)
        state = robot.state()
        wanted = commanded(state.xyz_world + [[0.0, 0.002, 0.0]], state.wxyz)
        arm = Topic(PLAN.controller, "trajectory_msgs/msg/JointTrajectory", depth=1)
        got = received(node, arm, lambda: robot.move(wanted, 0.01))
        assert got.joint_names == JOINTS
        assert got.points[0].positions == pytest.approx(np.array(ARM_HOME_RAD), abs=0.5)
        at_rest, cmd_vel = commanded(state.xyz_world, state.wxyz), Topic("/cmd_vel", "geometry_msgs/msg/TwistStamped", depth=1)
        base = received(node, cmd_vel, lambda: robot.move(at_rest, 0.01))
        assert abs(base.twist.linear.x) <= 0.3
        # what is sent last comes, although the node closes behind it
        time.sleep(0.2)
        node.reader(cmd_vel).take()
        robot.close()
        last = received(node, cmd_vel, lambda: None).twist
        assert last.linear.x == last.linear.y == last.angular.z == 0.0


@pytest.mark.parametrize("command", ["pose", "joints"])
def test_a_robot_that_another_program_drives_is_refused(tmp_path, command):
    """Even one that only stands there sends its own positions, and the robot would be thrown between both."""
    file, frame = tmp_path / "robot.xml", "tool" if command == "pose" else "right_hand"
    file.write_text(mobile_manipulator())
    with robot_node():
        first = open_ros_robot(command, PLAN, file, (frame,), SETTINGS)
        state = first.state()
        first.move(commanded(state.xyz_world, state.wxyz, brakes=True), 0.01)
        refusal(
            SourceError,
            f"another program sends {first.commands.copy().pop()}",
            open_ros_robot,
            command,
            PLAN,
            file,
            (frame,),
            SETTINGS,
        )
        first.close()
        # one that was closed is in no one's way
        open_ros_robot(command, PLAN, file, (frame,), SETTINGS).close()


def test_a_robot_without_a_model_is_refused_before_it_is_on_the_network():
    plan = SimpleNamespace(node=lambda name: pytest.fail("on the network"))
    refusal(ConfigError, "the model by which its joints", open_ros_robot, "joints", plan, None, ("tool",), SETTINGS)


def test_a_robot_whose_state_never_comes_leaves_the_network(monkeypatch):
    node = Node()
    monkeypatch.setattr(ros_robot, "_FIRST_S", 0.05)
    plan = SimpleNamespace(node=lambda name: node, base_frame="base")
    refusal(SourceError, "nothing of /tf from base to tool came", open_ros_robot, "pose", plan, None, ("tool",), SETTINGS)
    assert node.closed


def test_a_recording_whose_folder_is_removed_is_no_recording(tmp_path, monkeypatch):
    monkeypatch.setattr(bags, "_LOOK_S", 0.0)
    folder = tmp_path / "recorded"
    folder.mkdir()
    world = engaged_world(settings_for("point", roomy=False), 0)
    with closing(Reporter(Recorder(folder / "robot.mcap"), world.settings)) as reporter:
        tick(world, set())
        reporter.take(world.state, world.driver.follower.order)
        shutil.rmtree(folder)
        refusal(InputError, "the file is gone", reporter.take, world.state, world.driver.follower.order)


def test_state_target_box_and_diagnostics_are_recorded(tmp_path):
    file = tmp_path / "robot.mcap"
    world = engaged_world(settings_for("point", roomy=False), 0)
    reporter = Reporter(Recorder(file), world.settings)
    for _ in range(5):
        tick(world, set())
        reporter.take(world.state, world.driver.follower.order)
    reporter.close()
    topics = {one.topic for one in read_mcap(file)}
    parts = ("right/target_pose", "right/commanded", "right/measured", "engaged", "markers")
    assert topics == {*(f"/posefuse/teleoperation/{part}" for part in parts), "/diagnostics"}
