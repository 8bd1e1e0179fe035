"""A ROS 2 image topic, sent by another process on loopback."""

import threading
import time
from contextlib import nullcontext
from itertools import islice, takewhile
from types import SimpleNamespace

import numpy as np
import pytest
from own_domain import own_domain

pytest.importorskip("cyclonedds", reason="the extra `ros` is not installed")

from posefuse.core import Frame, SourceError
from posefuse.evaluation.contracts import check_source
from posefuse_ros.camera_messages import IMAGE_TYPE
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network
from posefuse_ros.source import RosConfig, RosSource
from posefuse_ros.topics import Topic

DOMAIN = own_domain()


def config(topic, wait_s=60.0, **more):
    return RosConfig(topic=topic, camera="cam02", domain_id=DOMAIN, local_only=True, wait_s=wait_s, **more)


def refusal(topic, wanted):
    """What `build` says of a topic, given longer as long as it has not yet heard of the one it is to name."""
    for wait_s in (1.0, 2.0, 5.0, 20.0):
        with pytest.raises(SourceError) as caught:
            config(topic, wait_s).build()
        if wanted in str(caught.value):
            break
    return str(caught.value)


@pytest.mark.parametrize("topic", ["/cam/image_raw", "/cam/image_raw/compressed"])
def test_it_keeps_the_contract_of_sources(sender, topic):
    source = config(topic, offset_s=-1_700_000_000.0).build()
    assert source.size_wh == (16, 12)
    frame = next(source.frames())
    assert 0 <= frame.t_ns < 60_000_000_000
    assert np.abs(frame.image[:, :6].astype(int) - 200).max() < 12
    check_source(source)


def test_images_of_another_size_or_older_are_refused_and_counted(sender):
    source = config("/cam/image_raw").build()
    frames = source.frames()
    # a slow reader loses messages, so it takes as many as it needs
    got = list(takewhile(lambda frame: source.refused_frames <= 5, islice(frames, 1000)))
    assert {f.size_wh for f in got} == {(16, 12)}
    assert source.refused_frames > 5
    source.close()
    assert source.last_refusal.startswith("topic /cam/image_raw: ")


@pytest.mark.parametrize("jump_s", [-7200, 7200])
def test_a_clock_that_is_set_shows_in_the_stamps_only(sender, monkeypatch, jump_s):
    source, real = config("/cam/image_raw").build(), time.time_ns
    frames = source.frames()
    before = next(frames).received_ns
    monkeypatch.setattr(time, "time_ns", lambda: real() + jump_s * 10**9)
    try:
        later = [frame.received_ns - before for frame in islice(frames, 20)]
    finally:
        source.close()
    assert 0 < later[-1] < 600e9


def test_closing_ends_the_frames(sender):
    source = config("/cam/image_raw").build()
    seen = []
    thread = threading.Thread(target=lambda: seen.extend(source.frames()))
    thread.start()
    source.close()
    thread.join(timeout=20)
    assert not thread.is_alive()


def test_what_is_closed_while_another_thread_uses_it_ends_quietly(monkeypatch):
    from cyclonedds.core import DDSException

    with RosNode("closed", Network(domain_id=DOMAIN, local_only=True)) as node:

        def wait(_: int) -> int:
            node.close()
            raise DDSException(-12, msg="Occurred while waiting")

        node._waitset = SimpleNamespace(wait=wait)
        assert node.wait(1.0) is False
    source = object.__new__(RosSource)
    source._closed, source._seq = False, 5
    source._first = Frame(camera="a", seq=0, t_ns=0, received_ns=0, image=np.zeros((3, 4, 3), np.uint8))

    def gone() -> list:
        source._closed = True
        raise SourceError("Cyclone DDS could not read")

    monkeypatch.setattr(source, "_take", gone, raising=False)
    assert list(source.frames()) == []


@pytest.mark.parametrize(
    ("topic", "words"),
    [
        ("/cam2/image_raw", f"image topics in domain {DOMAIN}: /cam/image_raw, /cam/image_raw/compressed"),
        ("/chatter", "it carries std_msgs/msg/String, expected sensor_msgs/msg/Image"),
    ],
    # a domain is each worker's own, and may not be part of a test's name
    ids=("missing", "another type"),
)
def test_a_missing_topic_or_one_of_another_type_is_reported(sender, topic, words):
    assert words in refusal(topic, words)


def test_an_overtaken_image_is_refused_and_a_clock_that_was_set_back_costs_none():
    source = object.__new__(RosSource)
    source._newest_ns, source._topic, source.size_wh = 100_000_000_000, Topic("/cam/image_raw", IMAGE_TYPE), (4, 3)
    image = np.zeros((3, 4, 3), np.uint8)
    for late_s, taken in ((0.0, False), (0.5, False), (5.0, True)):
        t_ns = source._newest_ns - round(late_s * 1e9)
        frame = Frame(camera="cam02", seq=1, t_ns=t_ns, received_ns=t_ns, image=image)
        with nullcontext() if taken else pytest.raises(SourceError, match="not newer"):
            source._check(frame)
