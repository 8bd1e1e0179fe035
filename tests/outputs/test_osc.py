import contextlib
import json
import socket
import struct
from dataclasses import replace

import numpy as np
import pytest
from checks import refusal
from made_up_session import made_up_start

from posefuse.core import ConfigError, LiveNames, LivePose
from posefuse.outputs.live import JsonConfig, OscConfig
from posefuse.outputs.live.udp import AXES, UdpStream, json_from_pose, osc_bundle, osc_from_pose, osc_message


def read(data):
    """An OSC 1.0 reader of the test's own: (time tag, [(address, arguments)])."""
    assert len(data) % 4 == 0
    if not data.startswith(b"#bundle\0"):
        return None, [read_message(data)]
    tag = struct.unpack(">II", data[8:16])
    found, at = [], 16
    while at < len(data):
        (size,) = struct.unpack_from(">i", data, at)
        found.append(read_message(data[at + 4 : at + 4 + size]))
        at += 4 + size
    return tag, found


def read_message(data):
    def text(at):
        end = data.index(b"\0", at)
        return data[at:end].decode(), (end // 4 + 1) * 4

    address, at = text(0)
    tags, at = text(at)
    arguments = []
    for tag in tags[1:]:
        arguments += struct.unpack_from(f">{tag}", data, at)
        at += 4
    return address, arguments


def test_the_examples_of_the_specification():
    assert osc_message("/oscillator/4/frequency", 440.0) == b"/oscillator/4/frequency\0,f\0\0\x43\xdc\0\0"
    expected = b"/foo\0\0\0\0,iiff\0\0\0" + struct.pack(">iiff", 1000, -1, 1.234, 5.678)
    assert osc_message("/foo", 1000, -1, 1.234, 5.678) == expected


def test_time_tags_count_from_1900():
    tag, _ = read(osc_bundle([osc_message("/a")], 1_500_000_000_250_000_000))
    assert tag == (1_500_000_000 + 2_208_988_800, 2**30)
    assert read(osc_bundle([], -1))[0] == (0, 1)


def test_addresses_that_cannot_be():
    refusal(ConfigError, "OSC", osc_message, "/kopf/über")


def test_a_pose_as_osc(some_pose, some_joints):
    pose = some_pose()
    datagrams = osc_from_pose(pose, some_joints, "z_up")
    assert all(len(d) <= 1400 for d in datagrams)
    values = dict(message for datagram in datagrams for message in read(datagram)[1])
    assert values["/posefuse/people"] == [40, 7]
    seen = np.isfinite(pose.xyz_world).all(axis=-1)
    for n, person in enumerate((40, 7)):
        for k, name in enumerate(pose.skeleton.keypoints):
            sent = values.get(f"/posefuse/{person}/{name}")
            sigma = np.sqrt(np.trace(pose.cov_world[n, k]) / 3)
            assert sent == (pytest.approx([*pose.xyz_world[n, k], sigma], rel=1e-6) if seen[n, k] else None)
    np.testing.assert_allclose(values["/posefuse/7/left_knee/adduction"], [some_joints.angle_rad[1, 1, 1, 1]], rtol=1e-6)


@pytest.mark.parametrize("axes", AXES)
def test_up_is_up_and_hands_are_as_said(axes, standing):
    (datagram,) = json_from_pose(standing(), None, axes)
    content = json.loads(datagram)
    up = {"z_up": 2, "y_up": 1, "y_up_left_handed": 1}[axes]
    assert content["keypoints"]["nose"][up] == pytest.approx(1.6)
    assert content["axes"] == axes
    assert np.linalg.det(AXES[axes]) == pytest.approx(-1 if "left_handed" in axes else 1)


def test_json_leaves_out_what_is_missing(standing, some_joints):
    pose = standing(left_wrist=(np.nan,) * 3)
    (datagram,) = json_from_pose(pose, None, "z_up", {1: ""})
    content = json.loads(datagram, parse_constant=pytest.fail)
    assert "left_wrist" not in content["keypoints"] and "name" not in content
    assert content["sigma_m"]["nose"] == pytest.approx(0.01)
    assert (content["person"], content["t_ns"], content["angles_rad"]) == (1, 5_000_000_000, {})


@contextlib.contextmanager
def listening():
    """A socket that listens, and its address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(5)
        yield listener, f"127.0.0.1:{listener.getsockname()[1]}"


def test_json_carries_the_names_that_people_are_given_while_the_session_runs(standing):
    with listening() as (listener, address):
        config = JsonConfig(to=(address,))
        output, pose = config.build(), LivePose(pose=standing())
        start, given = replace(made_up_start(1), names=("Ada", "Ben")), LiveNames(t_ns=0, names={1: "Grace"})
        assert isinstance(given, config.takes)
        for message in (start, pose, given, pose):
            output.take(message)
        assert [json.loads(listener.recv(65536))["name"] for _ in range(2)] == ["Ben", "Grace"]
        output.close()


def test_datagrams_reach_every_listener_and_absent_ones_do_no_harm(standing):
    with listening() as (one, first), listening() as (two, second):
        datagrams = json_from_pose(standing(), None, "z_up")
        with UdpStream([first, second, "127.0.0.1:9"]) as stream:
            for _ in range(50):
                stream.send(datagrams)
        assert one.recv(65536) == two.recv(65536) == datagrams[0]


def test_a_datagram_that_the_network_does_not_take_does_no_harm(standing):
    datagrams = json_from_pose(standing(), None, "z_up")
    with listening() as (listener, address), UdpStream([address]) as stream:
        stream.send([bytes(70_000), *datagrams])
        assert listener.recv(65536) == datagrams[0]


@pytest.mark.parametrize(
    "address", ["localhost", ":9000", "localhost:0", "localhost:99999", "localhost:x", "no.such.host.invalid:9000"]
)
def test_addresses_are_checked_at_once(address):
    refusal(ConfigError, "UDP address", UdpStream, [address])
    if not address.startswith("no.such.host"):
        # what no name can be, before a session begins
        refusal(ConfigError, "UDP address", OscConfig(to=(address,)).build)
