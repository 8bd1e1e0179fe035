"""Where a robot's frame is in the world, by the transforms other nodes publish."""

import time

import numpy as np
import pytest
from own_domain import own_domain

from posefuse.core import SE3, MessageError
from posefuse.messages.body_messages import transform
from posefuse.messages.frames import FrameReader, Frames
from posefuse.messages.types import message


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
    with pytest.raises(MessageError, match="tf of base: expected finite numbers"):
        frames.take(msg)
    assert frames.find("world", "base") is None


def test_transforms_of_others_are_used_and_own_ones_are_not():
    pytest.importorskip("cyclonedds", reason="the extra `ros` is not installed")
    from posefuse.messages.dds import RosNode
    from posefuse.messages.dds_domain import Network
    from posefuse.messages.topics import TF, TF_STATIC

    network, base, broken = Network(domain_id=own_domain(), local_only=True), some(5), some(6)
    with RosNode("posefuse", network) as ours, RosNode("robot", network) as robot:
        reader = FrameReader(ours)
        good, bad = transform(0, "world", "base", base), transform(0, "world", "bad", broken)
        bad.transform.rotation.w = float("inf")
        zero = transform(0, "world", "zero", broken)
        zero.transform.rotation = message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=0.0)
        robot.publish(TF_STATIC, message(TF.type_name, transforms=[bad, zero, good]), 0)
        end = time.monotonic() + 20
        while reader.frames.find("world", "base") is None and time.monotonic() < end:
            ours.publish(TF, message(TF.type_name, transforms=[transform(0, "world", "body_p1", base)]), 0)
            time.sleep(0.02)
            reader.update()
        np.testing.assert_allclose(reader.frames.find("world", "base").matrix4(), base.matrix4(), atol=1e-12)
        assert reader.frames.find("world", "body_p1") is None
        assert reader._intake.counts.refused == 2
