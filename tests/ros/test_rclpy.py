"""The node by rclpy against a minimal stand-in: rclpy itself comes with a ROS 2 installation only.

The stand-in has the signatures of rclpy's documentation (Jazzy): `publish` takes bytes, raw subscriptions give bytes and a
mapping with `source_timestamp`.
"""

import sys
import threading
from types import ModuleType, SimpleNamespace

import pytest
from checks import refusal

from posefuse.core import SE3, DependencyError
from posefuse_ros import topics
from posefuse_ros.live_output import Ros2Config
from posefuse_ros.rclpy_node import RclpyNode, ros2_is_sourced
from posefuse_ros.ros_output import RosOutput
from posefuse_ros.types import encode, message

INSTALLED = ("geometry_msgs", "sensor_msgs", "tf2_msgs", "visualization_msgs", "std_msgs", "diagnostic_msgs", "rosgraph_msgs")


class FakeNode:
    def __init__(self):
        self.publishers, self.subscriptions, self.destroyed = {}, {}, []

    def create_publisher(self, kind, name, profile):
        made = SimpleNamespace(kind=kind, profile=profile, sent=[], readers=1, get_subscription_count=lambda: made.readers)
        made.publish = made.sent.append
        self.publishers[name] = made
        return made

    def destroy_publisher(self, publisher):
        self.destroyed.append(publisher)

    def create_subscription(self, kind, name, callback, profile, *, raw):
        assert raw
        self.subscriptions[name] = SimpleNamespace(callback=callback, profile=profile)

    def destroy_node(self):
        self.destroyed.append(self)


@pytest.fixture
def fake(monkeypatch):
    node, stop, added = FakeNode(), threading.Event(), []

    def executor(*, context):
        return SimpleNamespace(add_node=added.append, spin=lambda: added == [node] and stop.wait(20), shutdown=stop.set)

    def get_message(name):
        if name.split("/")[0] not in INSTALLED:
            raise ModuleNotFoundError(name)
        return name

    def module(name, **content):
        made = ModuleType(name)
        vars(made).update(content)
        monkeypatch.setitem(sys.modules, name, made)

    started = {}
    module("rclpy", Context=lambda: SimpleNamespace(try_shutdown=stop.set), init=lambda **how: started.update(how),
           create_node=lambda name, *, context: node)  # fmt: skip
    module("rclpy.executors", SingleThreadedExecutor=executor)
    module("rclpy.qos", QoSProfile=lambda **fields: SimpleNamespace(**fields),
           ReliabilityPolicy=SimpleNamespace(RELIABLE="reliable", BEST_EFFORT="best effort"),
           DurabilityPolicy=SimpleNamespace(TRANSIENT_LOCAL="latched", VOLATILE="volatile"))  # fmt: skip
    module("rosidl_runtime_py")
    module("rosidl_runtime_py.utilities", get_message=get_message)
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/opt/ros/jazzy")
    return SimpleNamespace(node=node, started=started, stop=stop, added=added)


def test_what_is_published_are_the_bytes_of_ros_2(fake, standing, ring_rig):
    with RclpyNode("posefuse", 7) as node:
        output = RosOutput(node, ring_rig(2))
        output.start(0)
        output.step(standing())
        tf = fake.node.publishers["/tf"]
        assert tf.kind == "tf2_msgs/msg/TFMessage" and all(isinstance(raw, bytes) for raw in tf.sent)
        static = fake.node.publishers["/tf_static"]
        assert (static.profile.durability, static.profile.reliability, static.profile.depth) == ("latched", "reliable", 1)
        assert "/humans/bodies/p1/head/pose" in fake.node.publishers
        # types of packages that are not installed
        assert node.left_out >= {"/posefuse/pose", "/humans/bodies/tracked", "/humans/bodies/p1/skeleton2d"}
        tf.readers = 0
        assert not node.wanted(topics.TF) and node.wanted(topics.TF_STATIC)
        node.forget("/tf")
        assert fake.node.destroyed == [tf]
    node.close()
    assert (
        fake.added == [fake.node] and fake.started["domain_id"] == 7 and fake.stop.is_set() and fake.node in fake.node.destroyed
    )


def test_what_comes_in_is_read_as_from_dds(fake, standing):
    from posefuse_ros.messages import transform

    with RclpyNode("posefuse", 0) as node:
        reader = node.reader(topics.TF, wakes=False)
        node.reader(topics.TF_STATIC)
        there = transform(5, "world", "base", SE3.identity())
        raw = encode(message(topics.TF.type_name, transforms=[there]))
        fake.node.subscriptions["/tf"].callback(raw, {"source_timestamp": 5})
        [sample] = reader.take()
        assert sample.raw == raw and sample.sent_ns == 5
        assert fake.node.subscriptions["/tf_static"].profile.durability == "latched"
        refusal(DependencyError, "posefuse_msgs/msg/Pose3D is not installed", node.reader, topics.POSE)


def test_it_is_taken_where_ros_2_is_sourced_and_no_network_option_asks_for_dds(fake, monkeypatch):
    assert ros2_is_sourced()
    made = Ros2Config(domain_id=3)._node()
    assert isinstance(made, RclpyNode)
    made.close()
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    assert not ros2_is_sourced()


def test_without_rclpy_it_names_the_missing_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    refusal(DependencyError, "source a ROS 2 environment", RclpyNode, "x", 0)
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/opt/ros/jazzy")
    assert not ros2_is_sourced()
