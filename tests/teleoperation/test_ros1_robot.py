"""Robots of ROS 1, against a real roscore and a plain rospy program that stands for the robot."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from checks import refusal
from ros1_master import wait_for_master

pytest.importorskip("rosbags")
pytest.importorskip("mujoco")
pytest.importorskip("daqp")

from posefuse.core import MessageError
from posefuse_ros.messages import header
from posefuse_ros.ros1 import ros1_bytes, ros2_message
from posefuse_ros.types import encode, message
from posefuse_teleop.mujoco_robot import ARM_HOME_RAD, mobile_manipulator

HERE = Path(__file__).parent
JOINTS = {f"right_j{i + 1}": q for i, q in enumerate(ARM_HOME_RAD)}
SPACE = "/posefuse/teleoperation/tool"
CONTROLLER = "/joint_trajectory_controller/joint_trajectory"


@pytest.mark.parametrize(
    ("command", "topics"),
    [
        pytest.param("pose", {f"{SPACE}/target": "geometry_msgs/PoseStamped"}, marks=pytest.mark.slow),
        ("joints", {CONTROLLER: "trajectory_msgs/JointTrajectory", "/cmd_vel": "geometry_msgs/Twist"}),
    ],
)
def test_a_plain_ros1_robot_is_read_and_gets_its_commands(alone, ros1_python, tmp_path, command, topics):
    python, modules = ros1_python
    model = tmp_path / "robot.xml"
    model.write_text(mobile_manipulator())
    wait_for_master(alone, python)
    robot = alone(python, HERE / "ros1_robot.py", json.dumps(JOINTS), *topics)
    driver = alone(sys.executable, HERE / "ros1_driver.py", modules, command, model)
    out, err = robot.communicate(timeout=60)
    received = json.loads(out or "{}")
    assert {topic: kind for topic, (kind, _) in received.items()} == topics, err
    driver.terminate()
    line, driver_err = driver.communicate(timeout=20)
    assert line.startswith("["), line + driver_err
    xyz, q, fault = json.loads(line.splitlines()[0])
    assert fault == ""
    if command == "joints":
        assert q[-7:] == pytest.approx(list(ARM_HOME_RAD))
        assert "right_j7" in received[CONTROLLER][1]
    else:
        # the base stands at (2, 0), turned by a quarter
        assert xyz == pytest.approx([2.0, 0.3, 0.5])
        assert "base_link" in received[f"{SPACE}/target"][1]


@pytest.mark.slow
def test_a_robot_that_sends_nothing_is_one_line(alone, ros1_python, tmp_path):
    python, modules = ros1_python
    wait_for_master(alone, python)
    out, err = alone(sys.executable, HERE / "ros1_driver.py", modules, "pose", tmp_path).communicate(timeout=60)
    assert "SourceError robot: nothing of /tf from base_link to tool came within 10 s" in out, err


STATE = {"name": ["a", "b"], "position": np.array([1.0, 2.0]), "velocity": np.zeros(0), "effort": np.array([0.5])}
JOINT_STATE = message("sensor_msgs/msg/JointState", header=header(5_000_000_007, "base"), **STATE)
JOY = message("sensor_msgs/msg/Joy", header=header(1, ""), axes=np.array([0.25], np.float32), buttons=np.array([1, 0], np.int32))


@pytest.mark.parametrize("msg", [JOINT_STATE, JOY])
def test_bytes_of_ros1_come_back_as_they_went(msg):
    raw = ros1_bytes(msg)
    assert encode(ros2_message(raw, msg.__msgtype__)) == encode(msg)
    refusal(MessageError, "malformed ROS 1 message", lambda: ros2_message(raw[: len(raw) // 2], msg.__msgtype__))
