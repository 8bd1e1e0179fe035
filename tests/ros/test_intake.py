"""Strangers on the network: their messages are refused, counted and reported once, and the session does not notice them."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType, SimpleNamespace

import numpy as np
import pytest
from absurd import absurd_message
from built import camera_state
from no_outputs import KeptOutputs, NoOutputs

from posefuse.core import SKELETONS, CameraHealth, Detections2D, JointCentres, LiveJointCentres, LivePose, Rig, Skeleton
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.health.camera_monitor import Monitor
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.realtime.fusion_loop import Fusion
from posefuse.realtime.messages import SeenView
from posefuse.tracking.warm_up import made_up_detections
from posefuse_ros.camera_messages import message_from_joint_centres
from posefuse_ros.messages import message_from_detections
from posefuse_ros.network_views import Sample, Senders, ViewIntake
from posefuse_ros.types import encode

S = 1_000_000_000
T0 = 1_700_000_000 * S
COCO, BLAZE = SKELETONS["coco17"], BLAZEPOSE33


def no_person(camera: str, t_ns: int = T0, skeleton: Skeleton = BLAZE) -> Detections2D:
    return Detections2D.empty(camera, t_ns, skeleton)


def begun(*cameras: str) -> Senders:
    """Senders whose session has a skeleton."""
    senders = Senders(cameras)
    for name in cameras:
        senders.admits(no_person(name), "node")
    assert senders.skeleton == BLAZE
    return senders


# --- who may send


def test_another_skeleton_is_refused_counted_and_reported_once() -> None:
    senders = begun("a", "b")
    assert senders.admits(no_person("a"), "node")
    for _ in range(5):
        assert not senders.admits(no_person("a", skeleton=COCO), "stranger")
    (line,) = senders.news
    theirs, ours = "coco17 (17 keypoints)", "blazepose33 (33 keypoints)"
    assert line == f"camera a: views have the skeleton {theirs}, this session has {ours}: not used"
    assert senders.refused[line] == 5
    assert senders.admits(no_person("a"), "node")
    # the same name with other keypoints is another one
    senders.admits(no_person("a", skeleton=Skeleton("blazepose33", ("a", "b"))), "node")
    assert "blazepose33 (2 keypoints)" in senders.news[1]


def test_who_sent_first_keeps_the_camera_while_it_pauses() -> None:
    senders = Senders(("a", "b"))
    senders.present = {"node", "other node", "stranger"}
    assert senders.admits(no_person("a"), "node")
    assert senders.admits(no_person("b"), "other node")
    for seconds in (1, 60, 3600):
        at_ns = T0 + seconds * S
        assert not senders.admits(no_person("a", at_ns), "stranger")
    assert senders.news == ["camera a: views of a second sender (stranger) are not used, the camera is that of node"]
    assert senders.admits(no_person("a", at_ns), "node")
    # a node that was started again is another participant; the former one has left
    senders.present = {"node again", "other node"}
    assert senders.admits(no_person("a", at_ns), "node again")
    assert senders.sender("a") == "node again"


def test_memory_stays_bounded() -> None:
    senders = begun("a")
    for i in range(3000):
        senders.admits(no_person(f"camera {i}"), f"sender {i}")
        senders.admits(no_person("a", skeleton=Skeleton(f"s{i}", ("a",))), f"sender {i}")
    assert max(map(len, (senders.strangers, senders.refused, senders.news))) <= 102
    assert senders.strangers["others"] == 2900


# --- joint centres come from the node that sends the camera's views


def centres(cameras: str, table: JointCentres | None) -> LiveJointCentres:
    return LiveJointCentres(t_ns=T0, cameras=tuple(cameras), table=table)


def sample(what: LiveJointCentres | Detections2D, sender: str = "node") -> Sample:
    made = message_from_joint_centres(what) if isinstance(what, LiveJointCentres) else message_from_detections(what, {})
    return Sample(encode(made), 0, sender)


def test_joint_centres_are_taken_from_the_sender_of_the_views() -> None:
    views = ViewIntake(("a", "b"))
    table = JointCentres(made_by="a test", offsets={"hip": {"up": 0.01}})
    theirs = sample(centres("a", replace(table, made_by="a stranger")), "stranger")
    views.centres(sample(centres("ab", table)))
    views.centres(theirs)
    first, second = (views.view(sample(no_person("a")), T0) for _ in range(2))
    assert first[0] == centres("a", table)
    assert [type(one) for one in first[1:] + second] == [SeenView, SeenView]
    assert views.centres(theirs) == []
    assert views.centres(sample(centres("ab", None))) == [centres("a", None)]


# --- 10,000 messages


def session(rig: Rig, outlets: NoOutputs | None = None) -> tuple[Fusion, SimpleNamespace]:
    clock = SimpleNamespace(now=T0, now_ns=lambda: clock.now)
    return Fusion(rig, warmed_up(rig, BLAZE, LiveConfig()), lambda _: None, clock, outlets or NoOutputs()), clock


class Played:
    """A session of some seconds, and between its messages those that `others(i)` gives: what came out, and what was counted.

    `ahead_ns`: how far the clocks of the machines of some cameras are ahead.
    """

    def __init__(
        self, rig: Rig, time_steps: int, others=lambda i: (), ahead_ns: Mapping[str, int] = MappingProxyType({})
    ) -> None:
        self.views, kept = ViewIntake(rig.names), KeptOutputs()
        self.fusion, clock = session(rig, kept)
        for i, step in enumerate(made_up_detections(rig, BLAZE, time_steps, start_ns=T0)):
            for view in step:
                clock.now = view.t_ns + 20_000_000
                for strange in others(i):
                    self._feed(strange, clock.now)
                ahead = ahead_ns.get(view.camera, 0)
                theirs, done = replace(view, t_ns=view.t_ns + ahead), clock.now + ahead
                stages = {"received": theirs.t_ns + 5_000_000, "started": done, "detected": done}
                self._feed(
                    Sample(encode(message_from_detections(theirs, stages)), 0, "other node" if ahead else "node"), clock.now
                )
            self.fusion.tick(clock.now + 1, 10_000_000)
            self.fusion._judge(SimpleNamespace(messages=lambda: (), troubles=dict), clock.now, clock.now)
        self.poses = kept.poses()

    def _feed(self, message: Sample, now_ns: int) -> None:
        for received in self.views.view(message, now_ns):
            self.fusion.take(received)


def test_what_can_wait_is_done_just_after_each_output(ring_rig) -> None:
    fusion, clock = session(ring_rig(4))
    done: list[str] = []

    def passing() -> int:
        clock.now += 1_000_000
        return int(clock.now)

    clock.now_ns = passing
    fusion.estimator.tracker.check = lambda: done.append("what can wait")
    offer = lambda message: done.append("output") if isinstance(message, LivePose) else None  # noqa: E731
    fusion.outlets = SimpleNamespace(offer=offer, poll=lambda: None, health={})
    nothing = SimpleNamespace(channels=list, messages=lambda: (), troubles=dict)
    fusion.run(nothing, 100.0, lambda _: len(done) >= 6)
    assert done == ["output", "what can wait"] * 3


def absurd(rng: np.random.Generator, cameras: tuple[str, ...], near_ns: int | None = None) -> Sample:
    """A message whose bytes are fine and whose content is not, or bytes that are cut, changed or made up."""
    t_ns = T0 + int(rng.normal() * 10 ** rng.integers(3, 18)) % (10**17)
    received_ns = int(rng.integers(-(2**60), 2**60)) if near_ns is None else near_ns
    raw = absurd_message(rng, cameras, t_ns if near_ns is None else near_ns + t_ns % 10**8, received_ns)
    what = rng.random()
    if what < 0.2:
        raw = raw[: rng.integers(0, len(raw))]
    elif what < 0.4:
        changed = bytearray(raw)
        for place in rng.integers(0, len(raw), 8):
            changed[place] = rng.integers(0, 256)
        raw = bytes(changed)
    elif what < 0.45:
        raw = rng.bytes(int(rng.integers(0, 400)))
    return Sample(raw, int(rng.integers(-(2**62), 2**62)), str(rng.integers(0, 50)))


@pytest.fixture(scope="module")
def undisturbed(ring_rig) -> Played:
    return Played(ring_rig(4), 45)


def test_ten_thousand_strange_messages_change_nothing(undisturbed: Played, ring_rig) -> None:
    rng, rig = np.random.default_rng(0), ring_rig(4)

    def others(i: int) -> list[Sample]:
        # beginning when the session is under way: what comes first has a right to be heard
        return [absurd(rng, rig.names) for _ in range(59)] if i > 1 else []

    disturbed = Played(rig, 45, others)
    counts, senders = disturbed.views.intake.counts, disturbed.views.senders
    assert counts.accepted + counts.refused > 10_000
    assert counts.refused > 3000 and senders.strangers["elsewhere"] > 500
    assert len(disturbed.poses) == len(undisturbed.poses) == 45
    assert sum(len(pose.person_id) for pose in undisturbed.poses) > 40
    for ours, theirs in zip(undisturbed.poses, disturbed.poses, strict=True):
        np.testing.assert_array_equal(ours.person_id, theirs.person_id)
        np.testing.assert_array_equal(ours.xyz_world, theirs.xyz_world)
    assert {verdict.state for verdict in disturbed.fusion.verdicts.values()} == {"ok"}


@pytest.mark.parametrize("ahead_s", [3, -3, 7200])
def test_a_machine_whose_clock_is_far_off_is_timed_by_arrival_and_named_once(undisturbed: Played, ring_rig, ahead_s) -> None:
    rig = ring_rig(4)
    off = Played(rig, 45, ahead_ns=dict.fromkeys(rig.names[2:], ahead_s * S))
    assert len(off.poses) == len(undisturbed.poses)
    for pose, expected in zip(off.poses, undisturbed.poses, strict=True):
        np.testing.assert_array_equal(pose.xyz_world, expected.xyz_world)
    (line,) = off.views.senders.news
    assert any(name in line for name in rig.names[2:]) and f"{ahead_s:+.1f} s" in line and "NTP" in line


def test_a_node_that_goes_mad_costs_its_own_cameras_not_the_session(undisturbed: Played, ring_rig) -> None:
    """The same content from the node that the views come from: it is taken, and poses come back when it is right again."""
    rng, rig = np.random.default_rng(1), ring_rig(4)

    def others(i: int) -> list[Sample]:
        now_ns = T0 + i * S // 30
        return [absurd(rng, rig.names, now_ns)._replace(sender="node") for _ in range(20)] if 15 < i < 25 else []

    played = Played(rig, 75, others)
    assert len(played.poses) == 75
    # such messages did reach the tracker
    assert sum(played.fusion.used.values()) > sum(undisturbed.fusion.used.values()) + 30 * 4 + 20
    assert len(played.poses[-1].person_id) == 1
    assert np.isfinite(played.poses[-1].xyz_world).all()


# --- what another machine tells of a camera's source


def views_of(used_share: float) -> list[SeenView]:
    """Views of camera a over six seconds, of whose frames that share is used, as the fusion takes them from the network."""
    views, seen = ViewIntake(("a", "b")), []
    views.view(sample(no_person("a")), T0)
    for i in range(1, 181):
        t_ns = T0 + i * S // 30
        counts = camera_state("a", i, int(used_share * i))
        msg = message_from_detections(no_person("a", t_ns), {"received": t_ns + 5_000_000}, counts)
        seen += views.view(Sample(encode(msg), 0, "node"), t_ns + 10_000_000)
    return [one for one in seen if isinstance(one, SeenView)]


@pytest.mark.parametrize(("share", "state"), [(1.0, "moved"), (0.4, "overload")])
def test_overload_of_a_remote_camera_is_called_overload(share: float, state: str) -> None:
    monitor = Monitor(("a", "b"))
    for seen in views_of(share):
        now_ns = seen.detections.t_ns + 20_000_000
        if seen.state is not None:
            monitor.take_state(seen.state, now_ns)
        monitor.admit(seen.detections, now_ns, received_ns=seen.received_ns, still=seen.still)
    assert monitor.judge(now_ns, {}, {"a": CameraHealth("moved", "stands elsewhere")})["a"].state == state
    assert monitor.source("a").captured == 180


def test_judging_the_cameras_takes_no_view_that_would_make_an_output_late(ring_rig) -> None:
    """128 views wait, each of which takes a millisecond; the next output is due in three."""
    rig = Rig(tuple(replace(c, name=n) for c, n in zip(ring_rig(2), "ab", strict=True)), world_set_by="test")
    fusion, clock = session(rig)
    taken: list[object] = []

    def take(message: object) -> None:
        taken.append(message)
        clock.now += 1_000_000

    fusion.take = take
    clock.now = T0
    fusion._judge(SimpleNamespace(messages=lambda: iter(range(128)), troubles=dict), T0, T0 + 3_000_000)
    assert len(taken) == 3
