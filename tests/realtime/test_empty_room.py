"""Frames that come while no person is followed: not converted, and few of them sent."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from no_outputs import NoOutputs
from no_source import NoSourceConfig

from posefuse.core import Detections2D, Frame, Rig, Skeleton
from posefuse.detection.build import DetectorChoice
from posefuse.foundation.channel import Channel
from posefuse.realtime import group as group_module
from posefuse.realtime.capture import Caught, LiveInput
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.realtime.fusion import Fusion
from posefuse.realtime.group import Group, GroupPlan
from posefuse.realtime.messages import Expected, SeenView, SessionClock
from posefuse.sources.arriving import Arrived

S = 1_000_000_000
PERIOD_NS = S // 30
SKELETON = Skeleton("five", ("a", "b", "c", "d", "e"))


class CountedPixels:
    """An empty room, which counts how often its image is asked for."""

    size_wh = (64, 48)

    def __init__(self) -> None:
        self.asked = 0

    def rgb(self) -> np.ndarray:
        self.asked += 1
        return np.full((48, 64, 3), 90, np.uint8)

    def sample(self, step: int) -> np.ndarray:
        return np.full((4, 6, 3), 90, np.uint8)

    def fingerprint(self, step: int) -> bytes:
        return b"same"


class SeesNoPerson:
    """In place of a detector."""

    def __init__(self, choice: DetectorChoice, rig: Rig) -> None:
        self.skeleton, self.searched = SKELETON, 0

    def detect(self, frames: list[Frame], regions: list) -> list[Detections2D]:
        self.searched += sum(one is None for one in regions)
        return [Detections2D.empty(frame.camera, frame.t_ns, SKELETON) for frame in frames]


@pytest.fixture
def watched(ring_rig, monkeypatch: pytest.MonkeyPatch):
    """Lets a group look at `count` frames of one camera, and gives (messages, images asked for, searches)."""
    rig, clock_s = ring_rig(3, size_wh=(64, 48)), itertools.count(1000.0, 1 / 30)
    monkeypatch.setattr(group_module, "build_detector", SeesNoPerson)

    def look(count: int, people: int = 0) -> tuple[list[SeenView], int, int]:
        ours, theirs = Channel.pair()
        entry = LiveInput("cam00", "test", NoSourceConfig(), False)
        session = SessionClock.begin()
        plan = GroupPlan(
            rig=rig, inputs=(entry,), detector=DetectorChoice(), clock=session, most_people=1, search_every_s=1e6,
            preview_hz=0.0,
        )  # fmt: skip
        group = Group(plan, theirs)
        group._shift_ns["cam00"] = 0
        pixels = [CountedPixels() for _ in range(count)]
        for i, one in enumerate(pixels):
            if people:
                far = np.full((people, len(SKELETON), 3), 1e6)
                group._expected = Expected(session.now_ns(), far, np.zeros_like(far))
            now_s = next(clock_s)
            monkeypatch.setattr(group_module.time, "monotonic", lambda now_s=now_s: now_s)
            t_ns = 100 * S + i * PERIOD_NS
            arrived = Arrived(camera="cam00", seq=i, t_ns=t_ns, received_ns=t_ns + 20_000_000, pixels=one)
            group._look(group._captures[0], Caught(arrived, 0), group._expected)
        monkeypatch.undo()
        messages = list(iter(ours.receive, None))
        ours.close()
        theirs.close()
        return messages, sum(one.asked > 0 for one in pixels), group.detector.searched

    return look


def test_frames_without_an_expected_person_are_counted_and_five_a_second_reported(watched, ring_rig) -> None:
    messages, converted, searched = watched(90)
    assert 13 <= len(messages) <= 18
    # those of the last fifth of a second have yet to be counted
    counted = len(messages) + sum(one.skipped for one in messages)
    assert 84 <= counted <= 90
    # at once, after half a second, and a second later
    assert searched == converted == 3
    rig = ring_rig(3, size_wh=(64, 48))

    class Clock:
        def now_ns(self) -> int:
            return 103 * S

    fusion = Fusion(rig, warmed_up(rig, SKELETON, LiveConfig(joint_centres=False)), lambda _: None, Clock(), NoOutputs())
    for one in messages:
        fusion.take(one)
    assert fusion.used["cam00"] == counted


def test_with_a_person_every_frame_is_reported(watched) -> None:
    messages, _, _ = watched(30, people=1)
    assert len(messages) == 30 and not any(one.skipped for one in messages)


def test_views_that_would_make_the_next_output_late_wait(watched, ring_rig) -> None:
    messages, _, _ = watched(5, people=1)
    rig = ring_rig(3, size_wh=(64, 48))

    class Clock:
        """Every look at it takes a tenth of a millisecond: so does a view, which looks several times."""

        now = 101 * S

        def now_ns(self) -> int:
            self.now += 100_000
            return self.now

    class Intake:
        def __init__(self) -> None:
            self.left = list(messages)

        def channels(self) -> list[Channel]:
            return []

        def messages(self):
            while self.left:
                yield self.left.pop(0)

    clock, intake = Clock(), Intake()
    fusion = Fusion(rig, warmed_up(rig, SKELETON, LiveConfig(joint_centres=False)), lambda _: None, clock, NoOutputs())
    due_ns = clock.now + 800_000
    fusion._listen(intake, due_ns)
    assert 0 < len(intake.left) < 4
    assert due_ns <= clock.now < due_ns + 500_000
    fusion._listen(intake, clock.now + 50_000_000)
    assert not intake.left
    assert fusion.used["cam00"] == 5
