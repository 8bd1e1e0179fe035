"""Against a real roscore, in a network namespace that has nothing but loopback."""

import json
import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from checks import refusal
from ros1_master import wait_for_master

from posefuse.core import DependencyError
from posefuse_ros import ros1
from posefuse_ros.messages import diagnostic_status
from posefuse_ros.ros1 import ros1_bytes
from posefuse_ros.ros_output import RosOutput
from posefuse_ros.types import ros1_types

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


@pytest.fixture
def pose_file(tmp_path, standing, ring_rig):
    path = tmp_path / "pose.pickle"
    path.write_bytes(pickle.dumps((standing(left_wrist=(0.25, 0.2, 1.1)), ring_rig(2))))
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
    assert found["distortion_model"] == "plumb_bob"
    # as `rosmsg md5 diagnostic_msgs/DiagnosticArray` prints it
    assert found["diagnostics"] == [1, "60810da900de1dd6ddd437c3503511da"]
    assert found["topics"]["/posefuse/markers"] == "visualization_msgs/MarkerArray"
    assert found["topics"]["/humans/bodies/tracked"] == "hri_msgs/IdsList"


def test_without_a_master_it_names_the_cause(alone, ros1_python, pose_file):
    out, err = alone(sys.executable, HERE / "ros1_talker.py", ros1_python[1], pose_file).communicate(timeout=60)
    assert "SourceError ROS 1: no master answers at http://127.0.0.1:11311" in out, err


def test_without_rospy_it_names_the_missing_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "rosgraph", None)
    refusal(DependencyError, "python3-rospy", ros1.Ros1Node, "x")


def test_real_rosbag_reads_what_is_sent(tmp_path, kept, ros1_python, standing, ring_rig):
    output = RosOutput(kept, ring_rig(2, distortion=(0.1, 0.2, 0.3, 0.4)))
    output.start(1_000_000_000)
    output.step(standing())
    output.diagnose(6_000_000_000, [diagnostic_status("camera a", 2, "gone", {"age": "3 s"})])
    path = tmp_path / "a.bag"
    with pytest.importorskip("rosbags.rosbag1").Writer(path) as bag:
        made: dict = {}
        for topic, msg, t_ns in ((one.topic, one.msg, one.t_ns) for one in kept.sent):
            if topic.name not in made:
                made[topic.name] = bag.add_connection(topic.name, topic.type_name, typestore=ros1_types())
            bag.write(made[topic.name], t_ns, ros1_bytes(msg))
    program = (
        "import json, rosbag, sys\n"
        "bag = rosbag.Bag(sys.argv[1])\n"
        "found = {topic: (msg, t.to_nsec()) for topic, msg, t in bag.read_messages()}\n"
        "tf, t = found['/tf']; info = found['/posefuse/cam00/camera_info'][0]\n"
        "skeleton = found['/humans/bodies/p1/skeleton2d'][0]\n"
        "print(json.dumps([tf.transforms[0].child_frame_id, t, list(info.D), len(skeleton.skeleton),\n"
        "      found['/posefuse/markers'][0].markers[2].text, found['/diagnostics'][0].status[0].values[0].value,\n"
        "      found['/posefuse/pose'][0].skeleton]))\n"
    )
    run = subprocess.run([ros1_python[0], "-c", program, str(path)], capture_output=True, text=True, timeout=120)
    assert run.stdout, run.stderr
    assert json.loads(run.stdout) == ["body_p1", 5_000_000_000, [0.1, 0.2, 0.3, 0.4, 0.0], 18, "1", "3 s", "coco17"]


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
    sources = [
        *(ROOT / "packages/posefuse-ros/src/posefuse_ros").glob("*.py"),
        *(ROOT / "packages/posefuse-teleop").rglob("*.py"),
    ]
    types = {found for path in sources for found in re.findall(r'"(\w+_msgs)/msg/', path.read_text(encoding="utf-8"))}
    # rosgraph_msgs comes with rospy; Foxglove's types go to recordings of ROS 2 only
    wanted = {
        f"python3-{one.replace('_', '-')}" for one in types - {"posefuse_msgs", "hri_msgs", "foxglove_msgs", "rosgraph_msgs"}
    }
    listed = set(re.findall(r"python3-[a-z0-9-]+", (ROOT / "docs/ros.md").read_text(encoding="utf-8").split("## ROS 1")[1]))
    assert len(wanted) > 5 and wanted <= listed
    imported = {
        one for path in sources for one in re.findall(r"^\s+import (ros\w+|genpy)$", path.read_text(encoding="utf-8"), re.M)
    }
    # python3-rospy depends on the packages of all three
    assert {"rospy", "rosgraph", "genpy"} == imported - {"rosbags"}
