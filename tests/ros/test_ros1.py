"""Against a real roscore, in a network namespace that has nothing but loopback."""

import json
import pickle
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from checks import refusal
from ros1_master import wait_for_master

from posefuse.core import DependencyError
from posefuse_ros import ros1
from posefuse_ros.messages import header
from posefuse_ros.types import message, ros1_types

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


@pytest.fixture
def pose_file(tmp_path, standing, ring_rig):
    path = tmp_path / "pose.pickle"
    path.write_bytes(pickle.dumps((standing(left_wrist=(0.25, 0.2, 1.1)), ring_rig(2, distortion=(0.1, 0.2, 0.3, 0.4)))))
    return path


def test_plain_ros1_sees_tf_joints_cameras_and_diagnostics(alone, ros1_python, pose_file, ring_rig):
    pytest.importorskip("rosbags", reason="the extra `ros` is not installed")
    python, modules = ros1_python
    wait_for_master(alone, python)
    alone(sys.executable, HERE / "ros1_talker.py", modules, pose_file)
    out, err = alone(python, HERE / "ros1_listener.py").communicate(timeout=90)
    assert out, err
    found = json.loads(out)
    np.testing.assert_allclose(found["tf"]["l_wrist_p1"][:3], [0.25, 0.2, 1.1], atol=1e-9)
    camera = ring_rig(2)["cam01"]
    np.testing.assert_allclose(found["tf"]["cam01_optical_frame"][:3], camera.centre_world, atol=1e-9)
    assert found["joints"]["l_elbow_p1"] == pytest.approx(np.pi / 2)
    assert found["stamp_ns"] == 5_000_000_000
    np.testing.assert_array_equal(np.reshape(found["K"], (3, 3)), camera.K)
    assert (found["distortion_model"], found["D"]) == ("plumb_bob", [0.1, 0.2, 0.3, 0.4, 0.0])
    # as `rosmsg md5 diagnostic_msgs/DiagnosticArray` prints it
    assert found["diagnostics"] == [1, "3 s", "60810da900de1dd6ddd437c3503511da"]
    assert found["topics"]["/posefuse/markers"] == "visualization_msgs/MarkerArray"
    assert found["topics"]["/humans/bodies/tracked"] == "hri_msgs/IdsList"
    assert (found["markers"], found["pose"]) == ("1", "coco17")


def test_without_a_master_it_names_the_cause(alone, ros1_python, pose_file):
    out, err = alone(sys.executable, HERE / "ros1_talker.py", ros1_python[1], pose_file).communicate(timeout=60)
    assert "SourceError ROS 1: no master answers at http://127.0.0.1:11311" in out, err


def test_without_rospy_it_names_the_missing_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "rosgraph", None)
    refusal(DependencyError, "python3-rospy", ros1.Ros1Node, "x")


def test_bytes_hold_what_was_given():
    empty = np.zeros(0)
    state = message(
        "sensor_msgs/msg/JointState",
        header=header(5_000_000_007, "base"),
        name=["a", "b"],
        position=np.array([1.0, 2.0]),
        velocity=empty,
        effort=empty,
    )
    found = ros1_types().deserialize_ros1(ros1.ros1_bytes(state), state.__msgtype__)
    assert (found.header.stamp.sec, found.header.stamp.nanosec, found.header.frame_id) == (5, 7, "base")
    assert found.name == ["a", "b"] and found.position.tolist() == [1.0, 2.0] and not len(found.effort)


CHECKSUMS = {
    "hri_msgs/msg/IdsList": "84a63f55b5676f78b625e8a8bb809fe5",
    "tf2_msgs/msg/TFMessage": "94810edda583a504dfda3829e70d7eec",
    "sensor_msgs/msg/JointState": "3066dcd76a6cfaef579bd0f34173e9fd",
    "sensor_msgs/msg/CameraInfo": "c9a58c1b0b154e0e6da7578cb991d214",
    "visualization_msgs/msg/MarkerArray": "d155b9ce5188fbaf89745847fd5882d7",
}


@pytest.mark.parametrize("type_name", CHECKSUMS)
def test_types_have_the_checksums_ros1_programs_expect(type_name):
    assert ros1_types().generate_msgdef(type_name)[1] == CHECKSUMS[type_name]


def test_the_documented_packages_hold_every_type_that_is_sent():
    """`rostopic echo` needs the Python package of a type; ours and hri_msgs are built by the user, as docs/ros.md says."""
    paths = (ROOT / "packages/posefuse-ros/src/posefuse_ros").rglob("*.py")
    text = "\n".join(path.read_text(encoding="utf-8") for path in paths)
    # rosgraph_msgs comes with rospy
    types = {*re.findall(r'"(\w+_msgs)/msg/', text)} - {"posefuse_msgs", "hri_msgs", "rosgraph_msgs"}
    wanted = {f"python3-{one.replace('_', '-')}" for one in types}
    listed = set(re.findall(r"python3-[a-z0-9-]+", (ROOT / "docs/ros.md").read_text(encoding="utf-8").split("## ROS 1")[1]))
    assert len(wanted) > 5 and wanted <= listed
    imported = {*re.findall(r"^\s+import (ros\w+|genpy)$", text, re.M)}
    # python3-rospy depends on the packages of all three
    assert {"rospy", "rosgraph", "genpy"} == imported - {"rosbags"}
