"""Robots over ROS 2, against a node that stands for the robot."""

import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from checks import refusal
from commanded import commanded
from own_domain import own_domain

pytest.importorskip("cyclonedds")
pytest.importorskip("mujoco")
pytest.importorskip("daqp")

from posefuse.core import SE3, ConfigError
from posefuse_ros.dds_domain import Network
from posefuse_ros.messages import header, transform
from posefuse_ros.topics import TF, Topic
from posefuse_ros.types import decode, message
from posefuse_teleop.mujoco_robot import ARM_HOME_RAD, mobile_manipulator
from posefuse_teleop.ros import NAMESPACE, Reporter
from posefuse_teleop.ros_robot import JOINT_STATES, open_ros_robot
from posefuse_teleop.settings import RobotSettings, RosPlan, TeleoperationSettings

PLAN = RosPlan(network=Network(domain_id=own_domain(), local_only=True), cmd_vel="/cmd_vel")
SETTINGS = TeleoperationSettings(robot=RobotSettings(position_xy_m=(2.0, 0.0), heading_deg=90.0))
JOINTS = [f"right_j{i}" for i in range(1, 8)]


def joint_state(q):
    empty = np.zeros(0)
    state = header(time.time_ns(), "")
    return message("sensor_msgs/msg/JointState", header=state, name=JOINTS, position=np.array(q), velocity=empty, effort=empty)


@contextmanager
def robot_node():
    import threading

    node, ended = PLAN.node("robot"), threading.Event()
    bent = SE3.from_rotvec([0, 0, 0.3], [0.3, 0, 0.5])
    places = [transform(time.time_ns(), "base_link", "elbow", bent), transform(time.time_ns(), "elbow", "tool", SE3.identity())]

    def publish():
        while not ended.wait(0.02):
            t_ns = time.time_ns()
            node.publish(Topic(JOINT_STATES, "sensor_msgs/msg/JointState"), joint_state(ARM_HOME_RAD), t_ns)
            node.publish(TF, message("tf2_msgs/msg/TFMessage", transforms=places), t_ns)

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield node
    finally:
        ended.set()
        thread.join(10)
        node.close()


def received(node, topic, act, wanted=lambda msg: True):
    reader = node.reader(topic)
    for _ in range(200):
        act()
        time.sleep(0.02)
        for sample in reader.take():
            if wanted(msg := decode(sample.raw, topic.type_name, 10**6)):
                return msg
    pytest.fail(f"nothing on {topic.name}")


@pytest.mark.parametrize("command", ["pose", "twist"])
def test_a_cartesian_controller_gets_poses_or_velocities_in_its_base_frame(command):
    with robot_node() as node:
        robot = open_ros_robot(command, PLAN, None, ("tool",), SETTINGS)
        state = robot.state()
        # the base stands at (2, 0), turned by a quarter
        assert state.xyz_world[0] == pytest.approx([2.0, 0.3, 0.5]) and not state.fault
        name, kind = ("target", "PoseStamped") if command == "pose" else ("twist", "TwistStamped")
        topic = Topic(f"{NAMESPACE}/tool/{name}", f"geometry_msgs/msg/{kind}", depth=1)
        got = received(node, topic, lambda: robot.move(commanded(state.xyz_world, state.wxyz, (0.0, 0.2, 0.1)), 0.01))
        assert got.header.frame_id == "base_link"
        if command == "pose":
            place = got.pose.position
            assert [place.x, place.y, place.z] == pytest.approx([0.3, 0.0, 0.5])
        else:
            speed = got.twist.linear
            assert [speed.x, speed.y, speed.z] == pytest.approx([0.2, 0.0, 0.1])
            # what is sent last comes, although the node closes behind it
            robot.close()
            assert received(node, topic, lambda: None, wanted=lambda msg: msg.twist.linear.x == 0.0).twist.linear.y == 0.0
        robot.close()


@pytest.mark.parametrize("controller", ["/arm/joint_trajectory", "/arm/commands"])
def test_joints_of_our_inverse_kinematics_go_to_a_controller(tmp_path, controller):
    file = tmp_path / "robot.xml"
    file.write_text(mobile_manipulator())
    with robot_node() as node:
        robot = open_ros_robot("joints", replace(PLAN, controller=controller), file, ("right_hand",), SETTINGS)
        state = robot.state()
        wanted = commanded(state.xyz_world + [[0.0, 0.002, 0.0]], state.wxyz)
        kind = "std_msgs/msg/Float64MultiArray" if controller.endswith("/commands") else "trajectory_msgs/msg/JointTrajectory"
        got = received(node, Topic(controller, kind, depth=1), lambda: robot.move(wanted, 0.01))
        if kind.endswith("Trajectory"):
            assert got.joint_names == JOINTS and len(got.points[0].positions) == 7
            assert got.points[0].positions == pytest.approx(np.array(ARM_HOME_RAD), abs=0.5)
        else:
            assert got.data == pytest.approx(np.array(ARM_HOME_RAD), abs=0.5)
        at_rest = commanded(state.xyz_world, state.wxyz)
        base = received(
            node,
            Topic("/cmd_vel", "geometry_msgs/msg/TwistStamped", depth=1),
            lambda: robot.move(at_rest, 0.01),
        )
        assert abs(base.twist.linear.x) <= 0.3
        robot.close()


def test_what_cannot_be_is_refused_in_one_line():
    refusal(ConfigError, "the model of the robot", open_ros_robot, "joints", PLAN, None, ("tool",), SETTINGS)


def test_state_target_box_and_diagnostics_are_recorded(tmp_path):
    from bench.rehearsal.faults import engaged_world, tick
    from bench.rehearsal.world import settings_for
    from posefuse_ros.bags import Recorder, read_mcap

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
