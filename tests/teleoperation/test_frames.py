"""Where a robot's frame is in the world, by the transforms other nodes publish."""

import numpy as np
import pytest
from checks import refusal

pytest.importorskip("rosbags", reason="the extra `ros` is not installed")

from posefuse.core import SE3, MessageError
from posefuse_ros.body_messages import transform
from posefuse_ros.types import message
from posefuse_teleop.frames import Frames


def some(seed):
    rng = np.random.default_rng(seed)
    return SE3.from_rotvec(rng.normal(size=3), rng.normal(size=3))


def test_a_chain_is_walked_in_both_directions():
    frames, a, b, c = Frames(), some(1), some(2), some(3)
    frames.add("map", "world", a)
    frames.add("map", "odom", b)
    frames.add("odom", "base", c)
    expected = (b @ c).inverse() @ a
    np.testing.assert_allclose(frames.find("base", "world").matrix4(), expected.matrix4(), atol=1e-12)
    np.testing.assert_allclose(frames.find("world", "base").matrix4(), expected.inverse().matrix4(), atol=1e-12)
    np.testing.assert_allclose(frames.find("base", "base").matrix4(), np.eye(4))
    assert frames.find("base", "elsewhere") is None
    frames.add("odom", "base", a)
    np.testing.assert_allclose(frames.find("odom", "base").matrix4(), a.matrix4(), atol=1e-12)


def test_a_circle_of_frames_ends():
    frames = Frames()
    frames.add("a", "b", some(1))
    frames.add("b", "a", some(2))
    assert frames.find("world", "a") is None


def test_a_message_is_taken_with_and_without_a_leading_slash():
    frames, place = Frames(), some(3)
    frames.take(transform(0, "/world", "/base", place))
    np.testing.assert_allclose(frames.find("world", "base").matrix4(), place.matrix4(), atol=1e-12)
    np.testing.assert_allclose(frames.find("/base", "world").matrix4(), place.inverse().matrix4(), atol=1e-12)


@pytest.mark.parametrize("wrong", [{"x": float("nan")}, {"w": 0.4}, {}])
def test_a_message_without_a_rotation_is_refused(wrong):
    frames, msg = Frames(), transform(0, "world", "base", some(4))
    msg.transform.rotation = message("geometry_msgs/msg/Quaternion", **({"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0} | wrong))
    refusal(MessageError, "tf of base: expected finite numbers", frames.take, msg)
    assert frames.find("world", "base") is None
