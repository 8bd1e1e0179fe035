"""Which frames a process of several cameras looks at."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
from live_session import until
from no_source import NoSourceConfig

from posefuse.core import Detections2D, Frame, Rig
from posefuse.core.skeleton import PAPER14
from posefuse.detection.build import DetectorChoice
from posefuse.foundation.channel import Channel
from posefuse.realtime import capture as capture_module
from posefuse.realtime import group as group_module
from posefuse.realtime.capture import Capture, Caught, LiveInput
from posefuse.realtime.group import Group, GroupPlan
from posefuse.realtime.messages import Expected, SessionClock, VideoFailed
from posefuse.sources.arriving import Arrived

PERIOD_NS = 1_000_000_000 // 30
SKELETON = PAPER14
NAMES = ("cam00", "cam01", "cam02")


class SlowDetector:
    """Every camera has its next frame before one search has ended."""

    def __init__(self, choice: DetectorChoice, rig: Rig) -> None:
        self.skeleton, self.group, self.seq = SKELETON, None, 0

    def detect(self, frames: list[Frame], regions: list) -> list[Detections2D]:
        self.show_next()
        return [Detections2D.empty(frame.camera, frame.t_ns, SKELETON) for frame in frames]

    def show_next(self) -> None:
        """Of every camera, a frame that differs from the one before."""
        self.seq += 1
        image = np.full((48, 64, 3), 100 * (self.seq % 2), np.uint8)
        for name, capture in zip(NAMES, self.group._captures, strict=True):
            frame = Frame(camera=name, seq=self.seq, t_ns=self.seq * PERIOD_NS, received_ns=0, image=image)
            capture.put(Caught(Arrived.of(frame), 0))


@pytest.fixture
def group(ring_rig, monkeypatch: pytest.MonkeyPatch):
    """(group of three cameras, the end of the channel where its messages come)."""
    monkeypatch.setattr(group_module, "build_detector", SlowDetector)
    rig, (ours, theirs) = ring_rig(3, size_wh=(64, 48)), Channel.pair()
    plan = GroupPlan(
        rig=rig, inputs=tuple(LiveInput(name, "test", NoSourceConfig(), False) for name in NAMES),
        detector=DetectorChoice(), clock=SessionClock.begin(), most_people=1, search_every_s=1e6, preview_hz=0.0,
    )  # fmt: skip
    group = Group(plan, theirs)
    group._shift_ns = dict.fromkeys(NAMES, 0)
    group.detector.group = group
    group.detector.show_next()
    yield group, ours
    ours.close()
    theirs.close()


def test_while_no_person_is_followed_all_cameras_search_frames_of_one_time(group) -> None:
    group, channel = group
    for _ in range(3):
        group._look_at_next()
        seen = [message.detections for message in iter(channel.receive, None)]
        assert [view.camera for view in seen] == list(NAMES)
        assert len({view.t_ns for view in seen}) == 1


def test_with_a_person_the_frame_of_the_camera_that_waited_longest_is_looked_at(group) -> None:
    group, channel = group
    xyz = np.full((1, len(SKELETON), 3), 1e6)
    group._looked_s = dict(zip(NAMES, (2.0, 1.0, 3.0), strict=True))
    channel.send(Expected(group._plan.clock.now_ns(), xyz, np.zeros_like(xyz)))
    group._look_at_next()
    assert [message.detections.camera for message in iter(channel.receive, None)] == ["cam01"]


def test_a_video_that_cannot_be_made_when_it_is_switched_on_is_reported(group, tmp_path) -> None:
    group, ours = group
    (tmp_path / "cam01.mp4").touch()
    group._keep_videos(tmp_path)
    group._send_status()
    received = []
    while (message := ours.receive()) is not None:
        received.append(message)
    [failed] = [message for message in received if isinstance(message, VideoFailed)]
    assert failed.camera == "cam01" and "already exists" in failed.reason
    group._keep_videos(None)
    group.finish()


@dataclass(frozen=True)
class Raises:
    """A source of a plug-in that fails in a way of its own."""

    size_wh = (64, 48)

    def build(self) -> Raises:
        return self

    def frames(self) -> Iterator[Frame]:
        raise KeyError("exposure")
        yield

    def close(self) -> None: ...


def test_a_source_that_raises_anything_is_named_and_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_module, "_RETRY_S", 0.01)
    opened = []
    monkeypatch.setattr(Raises, "build", lambda self: opened.append(1) or self)
    capture = Capture(LiveInput("cam00", "test", Raises(), reopen=True), None, threading.Condition())
    capture.begin(time.monotonic_ns())
    try:
        until(lambda: len(opened) > 2)
        assert (capture.state().state, capture.state().text) == ("lost", "KeyError: 'exposure'")
    finally:
        capture.close()
