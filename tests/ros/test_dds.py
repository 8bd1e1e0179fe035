"""A node as others see it: a second process with Cyclone DDS and hand-written types, on loopback only."""

import json
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from checks import refusal
from live_session import until
from own_domain import own_domain
from running import Running

from posefuse.core import ConfigError, DependencyError, SourceError
from posefuse_ros import dds_domain, messages, topics
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network, domain_xml
from posefuse_ros.ros_output import RosOutput
from posefuse_ros.types import Intake, decode, encode, message, type_hash

pytest.importorskip("cyclonedds", reason="the extra `ros` is not installed")

PEER = Path(__file__).with_name("peer.py")
# what a ROS 2 user sets by CYCLONEDDS_URI; written by hand, not taken from domain_xml
PEER_XML = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General>"
    '<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer Address="localhost"/></Peers></Discovery>'
    "</Domain></CycloneDDS>"
)


def peer(what, domain_id):
    return subprocess.Popen([sys.executable, str(PEER), what, str(domain_id), PEER_XML], stdout=subprocess.PIPE, text=True)


def compressed(data):
    return message("sensor_msgs/msg/CompressedImage", header=messages.header(7, "f"), format="raw", data=data)


@pytest.fixture
def local():
    """A network that never leaves the machine; the domain keeps test runs at the same time apart."""
    return Network(domain_id=own_domain(), local_only=True)


def test_a_stranger_reads_and_sees_everything(local, standing, ring_rig):
    with RosNode("/lab/fusion", local) as node, peer("look", local.domain_id) as process:
        output = RosOutput(node, ring_rig(2))
        output.start(0)
        done = threading.Event()

        def publish():
            while not done.is_set():
                output.step(standing())
                time.sleep(0.01)

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            out, _ = process.communicate(timeout=60)
        finally:
            done.set()
            thread.join(10)
            process.kill()
    found = json.loads(out)
    assert found["tf"] == ["world", "body_p1", 5, pytest.approx(0.9)]
    assert found["tf_static"] == ["cam00_optical_frame", "cam01_optical_frame"]
    writers = found["writers"]
    assert writers["rt/tf"]["type"] == "tf2_msgs::msg::dds_::TFMessage_"
    assert writers["rt/posefuse/pose"]["type"] == "posefuse_msgs::msg::dds_::Pose3D_"
    # RIHS01 of tf2_msgs/TFMessage as ROS 2 Jazzy prints it
    assert writers["rt/tf"]["user_data"] == f"typehash={type_hash('tf2_msgs/msg/TFMessage')};"
    (node,) = found["nodes"]
    assert node["name"] == "/lab fusion"
    assert found["participants"][node["participant"]] == "enclave=/;"
    assert {w["gid"] for w in writers.values()} <= {*node["writers"]}
    assert {w["participant"] for w in writers.values()} == {node["participant"]}


def test_strangers_messages_are_refused_and_counted_and_the_good_ones_kept(local):
    intake, good, why = Intake(messages.DETECTIONS_TYPE, messages.detections_from_message), [], set()
    with RosNode("fusion", local) as node:
        reader = node.reader(topics.DETECTIONS)

        def take() -> None:
            for sample in reader.take():
                if (value := intake.take(sample.raw)) is not None:
                    good.append((value, sample.raw))
                why.add(intake.counts.last_refusal)

        with peer("shout", local.domain_id) as process:
            until(lambda: len(good) >= 5, take)
            process.kill()
    (view, stages), raw = good[0]
    assert (view.camera, view.skeleton.keypoints, stages) == ("stranger", ("a", "b"), {"captured": 5_000_000_006})
    np.testing.assert_array_equal(view.xy_img, [[[1, 2], [3, 4]]])
    # byte for byte what Cyclone DDS makes of the hand-written type
    assert encode(decode(raw, messages.DETECTIONS_TYPE, 2**20)) == raw
    assert intake.counts.refused >= 5
    assert any("at most 64 people, got 4000000000" in reason for reason in why)
    assert any("at most 1048576 bytes" in reason for reason in why)


def test_bytes_that_are_not_of_the_type_are_never_sent(local):
    with RosNode("one", local) as node:
        raw = encode(message("std_msgs/msg/String", data="hello"))
        refusal(SourceError, "could not write", lambda: node.writer(topics.DETECTIONS).write(raw))


def test_a_reader_that_holds_everything_up_costs_messages_not_the_session(local, monkeypatch):
    from cyclonedds import _clayer

    with RosNode("one", local) as node:
        writer = node.writer(topics.POSE)
        monkeypatch.setattr(_clayer, "ddspy_write", lambda ref, raw: -10)
        writer.write(b"")
        monkeypatch.setattr(_clayer, "ddspy_write", lambda ref, raw: -1)
        refusal(SourceError, r"could not write 0 bytes \(code -1\)", writer.write, b"")


def test_nodes_of_one_process_share_a_domain_if_they_agree_on_the_network(local):
    with RosNode("one", local), RosNode("two", local), pytest.raises(SourceError, match="open in this process as"):
        RosNode("three", Network(domain_id=local.domain_id, local_only=True, fragment_bytes=1300))
    RosNode("four", Network(domain_id=local.domain_id, local_only=True, fragment_bytes=1300)).close()


def test_nothing_leaves_and_nothing_waits_without_a_reader(local):
    with RosNode("lonely", local) as node:
        writer = node.writer(topics.preview("cam 1"))
        assert writer.readers() == 0
        raw = encode(compressed(np.zeros(10, np.uint8)))
        for _ in range(1000):
            writer.write(raw)
        assert node.wait(0.01) is False


def test_a_message_larger_than_a_datagram_arrives_whole(local):
    payload = np.random.default_rng(0).integers(0, 256, 2_000_000, np.uint8)
    topic = topics.Topic("/big", "sensor_msgs/msg/CompressedImage", depth=2)
    with RosNode("self", local) as node:
        reader = node.reader(topic)
        msg = compressed(payload)
        node.publish(topic, msg, 0)
        assert node.wait(5)
        (sample,) = reader.take()
    assert sample.raw == encode(msg)


def test_topics_of_others_with_their_types(local):
    with RosNode("self", local) as node:
        node.writer(topics.POSE)
        until(node.topics)
        assert node.topics() == {"/posefuse/pose": {"posefuse_msgs/msg/Pose3D"}}
        node.forget("/posefuse/pose")
        until(lambda: not node.topics())


def test_an_interface_that_is_not_there_is_reported():
    refusal(SourceError, r"no network interface 'nope0', there are: .*\blo\b", lambda: RosNode("x", Network(interface="nope0")))


def test_ports_in_use_are_reported():
    domain = own_domain()
    with ExitStack() as taken:
        for port in range(7410 + 250 * domain, 7410 + 250 * domain + 64):
            taken.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)).bind(("", port))
        with pytest.raises(
            SourceError, match=rf"domain {domain}: .*where other programs use all its UDP ports, choose another domain"
        ):
            RosNode("x", Network(domain_id=domain, local_only=True))
    RosNode("x", Network(domain_id=domain, local_only=True)).close()


@pytest.mark.parametrize(
    "wrong", [{"domain_id": 233}, {"domain_id": -1}, {"fragment_bytes": 70_000}, {"local_only": True, "peers": ("a",)}]
)
def test_settings_that_cannot_be(wrong):
    refusal(ConfigError, "network", Network, **wrong)


def test_addresses_are_quoted_in_the_configuration():
    xml = domain_xml(Network(peers=('"/><Evil a="',)))
    assert "<Evil" not in xml


def test_another_cyclonedds_is_refused(monkeypatch):
    monkeypatch.setattr(dds_domain, "TESTED_CYCLONEDDS", "0.0.0")
    refusal(DependencyError, r"expected version 0\.0\.0, got 11", lambda: RosNode("x", Network(local_only=True)))


_LISTENS = """
import time
from posefuse_ros import topics
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network
with RosNode("listens", Network(domain_id={domain}, local_only=True)) as node:
    reader = node.reader(topics.DETECTIONS)
    print("ready", flush=True)
    end_s = time.monotonic() + 2.0
    while time.monotonic() < end_s:
        node.wait(0.1)
        reader.take()
"""


def test_malformed_packets_of_anyone_are_not_printed_on_the_terminal() -> None:
    """Cyclone DDS has a line of half a kilobyte for each, and configures that away in no configuration."""
    domain, rng = 78, np.random.default_rng(0)
    command = [sys.executable, "-c", _LISTENS.format(domain=domain)]
    with Running(command) as listens:
        listens.out.wait_for("ready")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for _ in range(100):
                for port in range(7410 + 250 * domain, 7414 + 250 * domain):
                    head = b"RTPS\x02\x03\x01\x10" + rng.bytes(12)
                    gap = b"\x08\x01\x18\x00" + b"\xff" * 24
                    sender.sendto(head + gap, ("127.0.0.1", port))
        _, printed = listens.finished(60)
    assert listens.process.returncode == 0 and not printed
