"""Dead-man's switches report what is held, and nothing else."""

import json
import os
import struct
import time
import urllib.error
import urllib.request

import numpy as np
import pytest
from checks import refusal

from bench.rehearsal.person import person_view
from posefuse.core import ConfigError, SourceError
from posefuse_teleop.switches import GestureSwitch, JoystickSwitch, KeySwitch, WebSwitch, open_deadman

NOW_NS = 10**12


@pytest.fixture
def terminal():
    pty = pytest.importorskip("pty", reason="this system has no terminals of programs")
    ours, theirs = pty.openpty()
    stream = os.fdopen(theirs)
    yield ours, stream
    stream.close()
    os.close(ours)


def test_keys_of_a_terminal(terminal):
    keyboard, stream = terminal
    switch = KeySwitch(stream)
    assert switch.poll(NOW_NS, None).heartbeats == ()
    os.write(keyboard, b"  g")
    pressed = switch.poll(NOW_NS, None)
    assert [beat.sent_ns for beat in pressed.heartbeats] == [NOW_NS] and pressed.heartbeats[0].grip
    os.write(keyboard, b"xr")
    pressed = switch.poll(NOW_NS, None)
    assert pressed.emergency and pressed.reset and not pressed.heartbeats
    switch.close()
    switch.close()


def test_without_a_terminal_there_is_one_line(tmp_path):
    with open(tmp_path / "file", "w+") as file, pytest.raises(SourceError, match="no terminal"):  # noqa: PTH123
        KeySwitch(file)


def event(value, number, kind=1):
    return struct.pack("IhBB", 0, value, kind, number)


def test_a_joystick_is_held_until_it_is_let_go_or_pulled_out(tmp_path):
    pipe = tmp_path / "js0"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    writer = os.open(pipe, os.O_WRONLY)
    switch = JoystickSwitch(str(pipe))
    os.close(reader)
    os.write(writer, event(0, 0, 0x81) + event(1, 0))
    assert len(switch.poll(NOW_NS, None).heartbeats) == 1 and len(switch.poll(NOW_NS, None).heartbeats) == 1
    os.write(writer, event(1, 2)[:5])
    assert not switch.poll(NOW_NS, None).emergency
    os.write(writer, event(1, 2)[5:])
    assert switch.poll(NOW_NS, None).emergency
    os.write(writer, event(0, 0))
    assert not switch.poll(NOW_NS, None).heartbeats
    os.write(writer, event(1, 0))
    assert switch.poll(NOW_NS, None).heartbeats
    os.close(writer)
    assert not switch.poll(NOW_NS, None).heartbeats


def test_a_gesture_ticks_once_for_each_new_pose():
    from dataclasses import replace

    view = person_view(np.array([0.3, -0.25, 1.1]), NOW_NS, measured_ns=NOW_NS - 40_000_000)
    switch, up = GestureSwitch(), replace(view, gesture=True)
    assert not switch.poll(NOW_NS, view).heartbeats and not switch.poll(NOW_NS, None).heartbeats
    assert switch.poll(NOW_NS, up).heartbeats[0].sent_ns == NOW_NS - 40_000_000
    assert not switch.poll(NOW_NS, up).heartbeats


@pytest.fixture
def web():
    switch = WebSwitch()
    yield switch
    switch.close()


def post(web, content, path="beat"):
    body = content if isinstance(content, bytes) else json.dumps(content).encode()
    with urllib.request.urlopen(urllib.request.Request(web.url + path, data=body), timeout=5) as answer:
        return json.loads(answer.read())["echo"]


def test_the_page_is_there_and_its_reports_are_heartbeats(web):
    with urllib.request.urlopen(web.url, timeout=5) as answer:
        assert b"hold to move" in answer.read()
    echo = post(web, {"echo": 0, "held": True, "grip": False})
    assert not web.poll(0, None).heartbeats  # the first one knows no number
    before_ns = time.monotonic_ns()
    post(web, {"echo": echo, "held": True, "grip": True})
    heartbeats = web.poll(0, None).heartbeats
    assert len(heartbeats) == 1 and heartbeats[0].grip and heartbeats[0].sent_ns <= before_ns


def test_a_report_counts_once_and_is_as_old_as_the_number_it_echoes(web):
    echo = post(web, {"echo": 0, "held": False, "grip": False})
    given_ns = time.monotonic_ns()
    time.sleep(0.05)
    for _ in range(3):
        post(web, {"echo": echo, "held": True, "grip": False})
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
    post(web, {"echo": 0, "held": False, "grip": False, "event": "stop"})
    post(web, {"echo": 0, "held": False, "grip": False, "event": "other"})
    pressed = web.poll(0, None)
    assert pressed.emergency and not pressed.reset


def test_a_gesture_alone_is_refused_where_it_is_not_enough():
    refusal(ConfigError, "--i-have-an-emergency-stop", open_deadman, "gesture", gesture_allowed=False)
    open_deadman("gesture", gesture_allowed=True).close()


@pytest.mark.parametrize("text", ["", "keys", "joystick", "web:x", "ros:joy", "gesture:left"])
def test_an_unknown_switch_is_refused_in_one_line(text):
    refusal(ConfigError, "expected one of", open_deadman, text)
