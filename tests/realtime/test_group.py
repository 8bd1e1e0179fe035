"""Which cameras a process has, which of their frames it looks at, and how often it searches whole images."""

from __future__ import annotations

import itertools
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from types import SimpleNamespace
from unittest.mock import Mock

import built
import cv2
import numpy as np
import pytest
from live_session import until
from memory_source import Clip
from no_outputs import NoOutputs

from posefuse.core import Camera, Detections2D, Frame, Rig
from posefuse.core.depth import DepthImage, keypoint_depth
from posefuse.core.frames import Pixels
from posefuse.core.skeleton import COCO17, PAPER14
from posefuse.detection.build import DetectorChoice
from posefuse.foundation.channel import Channel
from posefuse.realtime import capture as capture_module
from posefuse.realtime import group as group_module
from posefuse.realtime.capture import Capture, Caught, LiveInput
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.realtime.fusion_loop import Fusion
from posefuse.realtime.group import Group, GroupPlan, SearchSchedule, search_slot
from posefuse.realtime.messages import Expected, LivePlan, SeenView, SessionClock
from posefuse.realtime.networks import on_device
from posefuse.realtime.session import blocks, group_plans

S = 1_000_000_000
PERIOD_NS = S // 30
SKELETON = PAPER14
NAMES = ("cam00", "cam01", "cam02")


class SeesNoPerson:
    """In place of a detector: looks at every image."""

    def __init__(self, choice: DetectorChoice, rig: Rig) -> None:
        self.skeleton, self.searched = SKELETON, 0

    def detect(self, frames: list[Frame], regions: list) -> list[Detections2D]:
        self.searched += sum(one is None for one in regions)
        return [Detections2D.empty(frame.camera, frame.t_ns, SKELETON) for frame in frames if frame.image.size]


class SlowDetector(SeesNoPerson):
    """Every camera has its next frame before one search has ended."""

    group, seq = None, 0

    def detect(self, frames: list[Frame], regions: list) -> list[Detections2D]:
        self.show_next()
        return super().detect(frames, regions)

    def show_next(self) -> None:
        """Of every camera, a frame that differs from the one before."""
        self.seq += 1
        image = np.full((48, 64, 3), 100 * (self.seq % 2), np.uint8)
        for name, capture in zip(NAMES, self.group._captures, strict=True):
            capture.put(Caught(built.frame(name, self.seq * PERIOD_NS, image, seq=self.seq), 0))


def plan_of(rig: Rig, clock: SessionClock, cameras: tuple[str, ...]) -> GroupPlan:
    inputs = tuple(LiveInput(name, "test", Clip(), False) for name in cameras)
    return GroupPlan(
        rig=rig, inputs=inputs, detector=DetectorChoice(), clock=clock, most_people=1, search_every_s=1e6, preview_hz=0.0
    )


@contextmanager
def opened(plan: GroupPlan) -> Iterator[tuple[Group, Channel]]:
    """(a group in this process, the end of the channel where its messages come)."""
    ours, theirs = Channel.pair()
    yield Group(plan, theirs), ours
    ours.close()
    theirs.close()


@pytest.fixture
def group(ring_rig, monkeypatch: pytest.MonkeyPatch):
    """See `opened`: of three cameras."""
    monkeypatch.setattr(group_module, "build_detector", SlowDetector)
    with opened(plan_of(ring_rig(3, size_wh=(64, 48)), SessionClock.begin(), NAMES)) as (group, ours):
        group.detector.group = group
        group.detector.show_next()
        yield group, ours


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


@pytest.fixture
def on_card(ring_rig, tmp_path, monkeypatch: pytest.MonkeyPatch):
    """(ONNX Runtime of a machine with a graphics card, gives the views of four cameras with a person)."""
    graphs = pytest.importorskip("graphs", reason="the package onnx is not installed")
    import discs

    runtime = graphs.ListsCuda()
    monkeypatch.setitem(sys.modules, "onnxruntime", runtime)
    rig = ring_rig(4, size_wh=(720, 560))
    discs.draw(rig, discs.true_xyz()[:1], tmp_path / "images")
    choice = DetectorChoice(name="onnx", options={"card": str(discs.card_of("simcc", tmp_path)), "streams": 1})
    xyz = discs.true_xyz()[:1]

    def views(together: bool = True, followed: bool = True) -> list[Detections2D]:
        clock, seen = SessionClock.begin(), list[SeenView]()
        [plan] = plans_on(rig, "cuda", choice, clock)
        assert plan.together
        with opened(replace(plan, together=together, most_people=1, search_every_s=1e6)) as (group, ours):
            runtime.batches.clear()
            group._searched_slot = dict.fromkeys(rig.names, search_slot(clock.now_ns(), 1e6))
            if followed:
                group._expected = Expected(clock.now_ns(), xyz, np.zeros_like(xyz))
            for name, capture in zip(rig.names, group._captures, strict=True):
                image = np.ascontiguousarray(cv2.imread(str(tmp_path / "images" / name / "000000.png"))[..., ::-1])
                capture.put(Caught(built.frame(name, clock.now_ns(), image), 0))
            while len(seen) < len(rig):
                group._look_at_next()
                seen += iter(ours.receive, None)
        return [one.detections for one in sorted(seen, key=lambda one: one.detections.camera)]

    return runtime, views


def plans_on(rig: Rig, device: str, choice: DetectorChoice, clock: SessionClock, groups: int | None = None) -> list[GroupPlan]:
    """Plans of groups on a device, of cameras that a test feeds itself."""
    inputs = tuple(LiveInput(name, "test", Clip(name, size_wh=rig[name].size_wh), False) for name in rig.names)
    config = LiveConfig(detector=on_device(choice, device), groups=groups)
    return group_plans(LivePlan(rig=rig, inputs=inputs, config=config, outputs={}), clock)


def test_on_a_graphics_card_the_waiting_images_of_all_cameras_go_in_one_call(on_card) -> None:
    runtime, views = on_card
    together = views()
    assert runtime.batches == [4] and runtime.cards == [0, 0]
    alone = views(together=False)
    assert runtime.batches == [1, 1, 1, 1]
    for one, other in zip(together, alone, strict=True):
        assert one.camera == other.camera and one.score.min() > 0.3
        np.testing.assert_allclose(one.xy_img, other.xy_img, atol=1e-5)
        np.testing.assert_allclose(one.sigma_px, other.sigma_px, atol=1e-5)


def test_a_search_of_all_cameras_in_one_call_finds_the_person_in_each(on_card) -> None:
    _, views = on_card
    assert [len(one) for one in views(followed=False)] == [1, 1, 1, 1]


@pytest.mark.parametrize(
    ("device", "groups", "devices"),
    [("cpu", 2, ["cpu", "cpu"]), ("cuda", None, ["cuda"]), ("cuda:0,cuda:1", None, ["cuda:0", "cuda:1"]),
     ("cuda:0,cuda:1", 3, ["cuda:0", "cuda:1", "cuda:0"])],
)  # fmt: skip
def test_one_group_per_graphics_card_looks_at_all_its_cameras_at_once(ring_rig, device, groups, devices) -> None:
    rig, choice = ring_rig(6), DetectorChoice(name="onnx", options={"card": "rtmpose_s"})
    plans = plans_on(rig, device, choice, SessionClock.begin(), groups)
    assert [plan.detector.options["device"] for plan in plans] == devices
    assert {plan.together for plan in plans} == {device != "cpu"}
    assert sorted(entry.camera for plan in plans for entry in plan.inputs) == list(rig.names)


def test_a_video_that_cannot_be_made_when_it_is_switched_on_is_reported(group, tmp_path) -> None:
    group, ours = group
    (tmp_path / "cam01.mp4").touch()
    group._keep_videos(tmp_path)
    group._send_status()
    *_, status = iter(ours.receive, None)
    [(camera, fault)] = status.video_faults.items()
    assert camera == "cam01" and "already exists" in fault
    group._keep_videos(None)
    group.finish()


def test_a_source_that_raises_anything_is_named_and_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a plug-in that fails in a way of its own."""
    monkeypatch.setattr(capture_module, "_RETRY_S", 0.01)
    plays = Mock(side_effect=KeyError("exposure"))
    with closing(Capture(LiveInput("cam00", "test", Clip(plays=plays), reopen=True), None, threading.Condition())) as capture:
        capture.begin(time.monotonic_ns())
        until(lambda: plays.call_count > 2)
        assert (capture.state().state, capture.state().text) == ("lost", "KeyError: 'exposure'")


@dataclass(frozen=True)
class CountsOn:
    """As cameras: its times are the machine's clock as it was when it was opened, carried on. It drops out after each frame."""

    opened_ns: int = 0
    size_wh = (64, 48)

    def build(self) -> CountsOn:
        return CountsOn(time.time_ns() - time.monotonic_ns())

    def frames(self) -> Iterator[Frame]:
        yield built.frame("cam00", time.monotonic_ns() + self.opened_ns, np.zeros((48, 64, 3), np.uint8))

    def close(self) -> None: ...


@pytest.mark.parametrize("step_s", [-3600, 3600])
def test_a_camera_that_is_opened_again_after_the_clock_was_set_is_on_the_sessions_clock(monkeypatch, step_s: int) -> None:
    """A network camera that dropped out once after NTP had set the clock: its video had no further frame, or a gap of an hour."""
    monkeypatch.setattr(capture_module, "_RETRY_S", 0.01)
    now_ns, news, taken = time.time_ns, threading.Condition(), list[Caught]()
    begun_ns, offset_ns = time.monotonic_ns(), SessionClock.begin().offset_ns

    with closing(Capture(LiveInput("cam00", "test", CountsOn(), reopen=True), None, news)) as capture:
        capture.open()
        monkeypatch.setattr(time, "time_ns", lambda: now_ns() + step_s * S)
        capture.begin(begun_ns, begun_ns + offset_ns)

        def three() -> bool:
            with news:
                taken.extend(filter(None, [capture.take()]))
            return len(taken) > 2

        until(three)
    assert all(0 <= one.t_ns - offset_ns - begun_ns < 600 * S for one in taken)


# --- frames that come while no person is followed: not converted, and few of them sent


class CountedPixels(Pixels):
    """An empty room, which counts how often its image is asked for."""

    size_wh = (64, 48)

    def __init__(self) -> None:
        self.asked = 0

    def rgb(self) -> np.ndarray:
        self.asked += 1
        return np.full((48, 64, 3), 90, np.uint8)

    def brightness(self, step: int) -> np.ndarray:
        return np.full((4, 6), 90, np.uint8)


@pytest.fixture
def watched(ring_rig, monkeypatch: pytest.MonkeyPatch):
    """Lets a group look at `count` frames of one camera, and gives (messages, images asked for, searches)."""
    rig, clock_s = ring_rig(3, size_wh=(64, 48)), itertools.count(1000.0, 1 / 30)
    monkeypatch.setattr(group_module, "build_detector", SeesNoPerson)

    def look(count: int, people: int = 0) -> tuple[list[SeenView], int, int]:
        session, pixels = SessionClock.begin(), [CountedPixels() for _ in range(count)]
        with opened(plan_of(rig, session, NAMES[:1])) as (group, ours):
            for i, one in enumerate(pixels):
                if people:
                    far = np.full((people, len(SKELETON), 3), 1e6)
                    group._expected = Expected(session.now_ns(), far, np.zeros_like(far))
                now_s = next(clock_s)
                monkeypatch.setattr(group_module.time, "monotonic", lambda now_s=now_s: now_s)
                t_ns = 100 * S + i * PERIOD_NS
                frame = built.frame("cam00", t_ns, one, seq=i, received_ns=t_ns + 20_000_000)
                group._look([(group._captures[0], Caught(frame, 0))], group._expected)
            monkeypatch.undo()
            messages = list(iter(ours.receive, None))
        return messages, sum(one.asked > 0 for one in pixels), group.detector.searched

    return look


def fusion_of(ring_rig, clock) -> Fusion:
    rig = ring_rig(3, size_wh=(64, 48))
    return Fusion(rig, warmed_up(rig, SKELETON, LiveConfig(joint_centres=False)), lambda _: None, clock, NoOutputs())


def test_frames_without_an_expected_person_are_counted_and_five_a_second_reported(watched, ring_rig) -> None:
    messages, converted, searched = watched(90)
    assert 13 <= len(messages) <= 18
    # those of the last fifth of a second have yet to be counted
    counted = len(messages) + sum(one.skipped for one in messages)
    assert 84 <= counted <= 90
    # at once, after half a second, and a second later
    assert searched == converted == 3
    fusion = fusion_of(ring_rig, SimpleNamespace(now_ns=lambda: 103 * S))
    for one in messages:
        fusion.take(one)
    assert fusion.used["cam00"] == counted


def test_with_a_person_every_frame_is_reported(watched) -> None:
    messages, _, _ = watched(30, people=1)
    assert len(messages) == 30 and not any(one.skipped for one in messages)


def test_views_that_would_make_the_next_output_late_wait(watched, ring_rig) -> None:
    left, _, _ = watched(5, people=1)
    # every look at the clock takes a tenth of a millisecond: so does a view, which looks several times
    now_ns = itertools.count(101 * S, 100_000)
    intake = SimpleNamespace(channels=list, messages=lambda: (left.pop(0) for _ in range(len(left))))
    fusion = fusion_of(ring_rig, SimpleNamespace(now_ns=now_ns.__next__))
    due_ns = 101 * S + 800_000
    fusion._listen(intake, due_ns)
    assert 0 < len(left) < 4
    assert due_ns <= next(now_ns) < due_ns + 500_000
    fusion._listen(intake, next(now_ns) + 50_000_000)
    assert not left
    assert fusion.used["cam00"] == 5


PERSON = built.standing()


class SeesPerson(SeesNoPerson):
    """Marks a person who stands still, off by 2 px again in every image."""

    def __init__(self, choice: DetectorChoice, rig: Rig) -> None:
        self.skeleton, self.rig, self.random = COCO17, rig, np.random.default_rng(6)

    def detect(self, frames: list[Frame], regions: list) -> list[Detections2D]:
        off_px = self.random.normal(0, 2.0, (len(frames), 1, *PERSON.shape[:1], 2))
        seen = [self.rig[frame.camera].project(PERSON) for frame in frames]
        return [built.detections(frame.camera, xy + off, frame.t_ns) for frame, xy, off in zip(frames, seen, off_px, strict=True)]


def depth_of_person(camera: Camera) -> DepthImage:
    """In mm, 0 where nothing is: a patch about each keypoint, as far before it as the surface of a body is."""
    z = (camera.cam_from_world @ PERSON)[:, 2]
    xy = camera.project(PERSON)
    behind = keypoint_depth(np.stack([z, np.zeros(len(z))], axis=-1), camera.norm_from_px(xy), COCO17)[:, 0] - z
    values = np.zeros(camera.size_wh[::-1], np.uint16)
    for (x, y), surface_m in zip(xy.round().astype(int), z - behind, strict=True):
        values[y - 6 : y + 7, x - 6 : x + 7] = round(1000 * surface_m)
    return DepthImage(values=values)


def test_a_depth_camera_as_the_second_of_two_side_by_side_places_the_person(ring_rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(ring_rig(90).cameras[:2])
    monkeypatch.setattr(group_module, "build_detector", SeesPerson)
    inputs = tuple(LiveInput(name, "test", Clip(size_wh=(640, 480)), False) for name in rig.names)
    plan = replace(plan_of(rig, SessionClock.begin(), ()), inputs=inputs)
    found, image = {}, np.zeros((480, 640, 3), np.uint8)
    for depth in (None, depth_of_person(rig["cam01"])):
        now = SimpleNamespace(now_ns=lambda: 102 * S)
        fusion = Fusion(rig, warmed_up(rig, COCO17, LiveConfig(joint_centres=False)), lambda _: None, now, NoOutputs())
        with opened(plan) as (group, ours):
            for i in range(30):
                t_ns = 101 * S + i * PERIOD_NS
                frames = [built.frame(name, t_ns, image, seq=i, depth=depth if name == "cam01" else None) for name in rig.names]
                group._look([(c, Caught(one, 0)) for c, one in zip(group._captures, frames, strict=True)], group._expected)
            messages: list[SeenView] = list(iter(ours.receive, None))
        assert [one.detections.depth_m is not None for one in messages] == 30 * [False, depth is not None]
        for one in messages:
            fusion.take(one)
        found[depth is not None] = fusion.estimator.at(102 * S)
    # rays that are 4 degrees apart place no person; depth alone is known to a few cm
    assert not len(found[False].person_id)
    assert np.median(np.linalg.norm(found[True].xyz_world[0] - PERSON, axis=-1)) < 0.05


def test_neighbours_share_a_process_in_whatever_order_they_are_named(ring_rig) -> None:
    """For 3 to 8 cameras in a ring the worst loss of a process is then within 3 % of the least of all assignments."""
    rig = ring_rig(6)
    shuffled = [rig.names[i] for i in (4, 0, 2, 5, 1, 3)]
    assert blocks(rig, shuffled, 3) == [["cam04", "cam05"], ["cam00", "cam01"], ["cam02", "cam03"]]
    # cameras of other machines are not dealt, but count for the middle
    assert blocks(rig, rig.names[:4], 2) == [["cam00", "cam01"], ["cam02", "cam03"]]
    assert blocks(rig, rig.names[:5], 2) == [["cam00", "cam01", "cam02"], ["cam03", "cam04"]]
    assert blocks(rig, rig.names[:3], 3) == [["cam00"], ["cam01"], ["cam02"]]


# --- how often whole images are searched while no person is followed


PERIOD_S = 1 / 30
STEP = 12


def room(rng: np.random.Generator, person: int = 0, contrast: float = 100.0, noise: float = 5.0) -> np.ndarray:
    """(480, 648, 3) image of a room seen by a noisy camera, with a person as high as so many sampled pixels in it."""
    image = np.full((480, 648, 3), 100.0, np.float32)
    image[10 * STEP : (10 + person) * STEP, 20 * STEP : 21 * STEP] += contrast
    image += noise * rng.standard_normal(image.shape, np.float32)
    return image.clip(0, 255).astype(np.uint8)


def searches(seconds: float, image_at, found_at=lambda t_s: False, period_s: float = PERIOD_S) -> list[float]:
    """Times at which a camera is searched."""
    schedule, done = SearchSchedule(), []
    for t_s in np.arange(0, seconds, period_s):
        sample = image_at(t_s)[::STEP, ::STEP, 1].copy()
        if schedule.due(sample, t_s):
            schedule.searched(sample, t_s, found_at(t_s))
            done.append(float(t_s))
    return done


def of(images: list[np.ndarray]):
    """One after the other, again and again: noise for thousands of images would take the test its time."""
    return lambda t_s: images[round(t_s / PERIOD_S) % len(images)]


def test_a_room_in_which_nothing_changes_is_searched_every_ten_seconds() -> None:
    rng = np.random.default_rng(1)
    waits = np.diff([t_s for t_s in searches(120, of([room(rng) for _ in range(7)])) if t_s > 10])
    assert waits == pytest.approx([10] * len(waits), abs=2 * PERIOD_S)


@pytest.mark.parametrize(("height", "contrast", "within_s"), [(4, 100.0, PERIOD_S), (8, 20.0, 10 + 2 * PERIOD_S)])
def test_a_person_who_comes_in_is_searched_at_once_and_one_too_faint_within_ten_seconds(height, contrast, within_s) -> None:
    rng = np.random.default_rng(4)
    empty, there = [[room(rng, person, contrast) for _ in range(7)] for person in (0, height)]
    done = searches(60, lambda t_s: of(there if t_s >= 47.3 else empty)(t_s))
    assert min(t_s for t_s in done if t_s >= 47.3) < 47.3 + within_s


def test_every_frame_is_searched_while_people_move_or_are_found() -> None:
    rng = np.random.default_rng(3)
    images = {person: room(rng, person) for person in (3, 9)}
    moving = searches(2, lambda t_s: images[3 + round(t_s / PERIOD_S) % 2 * 6])
    found = searches(2, lambda _: images[3], found_at=lambda _: True)
    assert len(moving) == len(found) == 60
