"""Dead-man's switches report what is held, and nothing else."""

import json
import socket
import time
import urllib.error
import urllib.request
from types import SimpleNamespace

import numpy as np
import pytest
from checks import refusal

import posefuse as pf
from posefuse.core import ConfigError, SourceError
from posefuse_ros.messages import header
from posefuse_ros.types import encode, message
from posefuse_teleop.gate import Heartbeats
from posefuse_teleop.settings import RosPlan
from posefuse_teleop.switches import WebSwitch, open_deadman

NOW_NS = 10**12


@pytest.fixture
def web():
    switch = WebSwitch()
    yield switch
    switch.close()


def post(web, content=None, **fields):
    """A report of a page that knows no number and is not held, or with other fields, or any bytes."""
    body = json.dumps({"echo": 0, "held": False, "grip": False, **fields}).encode() if content is None else content
    with urllib.request.urlopen(urllib.request.Request(f"{web.url}beat", data=body), timeout=5) as answer:
        return json.loads(answer.read())["echo"]


def test_the_page_is_there_and_its_reports_are_heartbeats(web):
    with urllib.request.urlopen(web.url, timeout=5) as answer:
        assert b"hold to move" in answer.read()
    echo = post(web, held=True)
    assert not web.poll(0, None).heartbeats  # the first one knows no number
    before_ns = time.monotonic_ns()
    post(web, echo=echo, held=True, grip=True)
    heartbeats = web.poll(0, None).heartbeats
    assert len(heartbeats) == 1 and heartbeats[0].grip and heartbeats[0].sent_ns <= before_ns


def test_an_answer_does_not_wait_for_the_receipt_of_its_head(web, monkeypatch):
    """It did for 40 ms: heartbeats were older than a button may be silent."""
    taken: list[int] = []
    handler = web._server.RequestHandlerClass
    ended = handler.end_headers
    no_delay = socket.IPPROTO_TCP, socket.TCP_NODELAY
    monkeypatch.setattr(handler, "end_headers", lambda own: (taken.append(own.connection.getsockopt(*no_delay)), ended(own)))
    post(web, held=True)
    assert taken and all(taken)


def test_a_report_counts_once_and_is_as_old_as_the_number_it_echoes(web):
    echo = post(web)
    given_ns = time.monotonic_ns()
    time.sleep(0.05)
    for _ in range(3):
        post(web, echo=echo, held=True)
    heartbeats = web.poll(0, None).heartbeats
    assert len(heartbeats) == 1 and heartbeats[0].sent_ns <= given_ns


@pytest.mark.parametrize(
    "content", [b"", b"[]", b"{", b'{"echo": "x"}', b'{"echo": 1e999, "held": true, "grip": 1}', b"\xff\xfe"]
)
def test_what_is_malformed_holds_nothing(web, content):
    post(web, content)
    assert not web.poll(0, None).heartbeats


def test_only_who_knows_the_key_can_press(web):
    base = web.url.rsplit("/", 2)[0]
    for path in ("/", "/x/beat"):
        with pytest.raises(urllib.error.HTTPError):
            urllib.request.urlopen(urllib.request.Request(base + path, data=b"{}"), timeout=5)


def test_buttons_of_the_page(web):
    for event in ("stop", "other"):
        post(web, event=event)
    pressed = web.poll(0, None)
    assert pressed.emergency and not pressed.reset


@pytest.mark.parametrize("text", ["", "key", "joystick", "web:x", "ros:joy", "gesture"])
def test_an_unknown_switch_is_refused_in_one_line(text):
    refusal(ConfigError, "expected one of", open_deadman, text)


def joy(monkeypatch, *ahead_s: float) -> Heartbeats:
    """After messages with the button down whose stamps are so far ahead of this machine's clock."""
    held = {"axes": np.zeros(1, np.float32), "buttons": np.ones(1, np.int32)}
    raw, epoch_ns = encode(message("sensor_msgs/msg/Joy", header=header(1, ""), **held)), 1_700_000_000 * 10**9
    monkeypatch.setattr(time, "time_ns", lambda: epoch_ns)
    samples = [SimpleNamespace(raw=raw, sent_ns=epoch_ns + round(ahead * 1e9)) for ahead in ahead_s]
    node = SimpleNamespace(reader=lambda _: SimpleNamespace(take=lambda: samples), close=lambda: None)
    monkeypatch.setattr(RosPlan, "node", lambda plan, name: node)
    heartbeats = Heartbeats()
    for beat in open_deadman("ros:/joy").poll(NOW_NS, None).heartbeats:
        heartbeats = heartbeats.with_beat(beat, NOW_NS)
    return heartbeats


def test_messages_of_a_joystick_in_ros_count_by_when_they_were_sent(monkeypatch):
    assert joy(monkeypatch, -0.09, -0.05, -0.01).held(NOW_NS)
    assert joy(monkeypatch, 0.01, 0.02, 0.04).held(NOW_NS)
    # of a machine whose clock is ahead: how old they are is not known
    assert joy(monkeypatch, 3.0, 3.05, 3.1).count == 0
    assert joy(monkeypatch, -3.1, -3.05, -3.0).count == 0


def test_a_joystick_in_ros_is_where_the_session_has_ros(demo_session, monkeypatch):
    pytest.importorskip("cyclonedds", reason="the extra `ros` is not installed")

    def node(plan, name):
        raise SourceError(f"{name} in domain {plan.network.domain_id}")

    monkeypatch.setattr(RosPlan, "node", node)
    session = pf.live(demo_session / "rig.toml", [f"sim:{demo_session}"], ros={"domain_id": 5, "sim_time": True})
    refusal(SourceError, "posefuse_deadman in domain 5", pf.teleoperate, session, deadman="ros:/joy")
