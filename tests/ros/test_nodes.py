"""One session on two machines, here two processes on the loopback device."""

import json
import signal
import sys
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import built
import numpy as np
import pytest
from live_session import FAULTY, until
from no_outputs import KeptOutputs, StillPerson
from own_domain import own_domain
from running import Running

pytest.importorskip("cyclonedds")

from posefuse.core import JointCentres, LiveJointCentres, LiveStart, Rig, SourceError
from posefuse.core.skeleton import COCO17
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import Centring, Estimator
from posefuse.realtime.fusion_loop import Fusion
from posefuse.realtime.messages import SeenView, SessionClock
from posefuse_ros import topics
from posefuse_ros.camera_info import publish_intrinsics
from posefuse_ros.camera_messages import info_from_camera, message_from_joint_centres
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network
from posefuse_ros.live_output import Ros2Config
from posefuse_ros.messages import DETECTIONS_TYPE, POSE_TYPE, detections_from_message, message_from_detections, pose_from_message
from posefuse_ros.network_views import NetworkViews
from posefuse_ros.nodes import CameraNode
from posefuse_ros.types import Intake

pytestmark = pytest.mark.realtime
DOMAIN = own_domain()
NETWORK = Network(domain_id=DOMAIN, local_only=True)
PATIENCE_S = 120.0
# all nodes show their videos from then on
ZERO_S = time.time()


def node(part: str, session: Path, *options: str) -> Running:
    command = [sys.executable, str(FAULTY), "--zero", str(ZERO_S), "--", "node", part, str(session / "rig.toml"), "--json"]
    command += ["--local-only", "--domain", str(DOMAIN), *options]
    return Running(command)


def stopped(running: Running) -> dict:
    running.process.send_signal(signal.SIGINT)
    out, err = running.finished()
    assert running.process.returncode == 0, err
    return json.loads(out)


def wait_until_received(views: dict[str, int], poses: int) -> None:
    """Listen next to the nodes until so many views of each camera, and poses with a person in them, have come."""
    end = time.monotonic() + PATIENCE_S
    with RosNode("listener", NETWORK) as listener:
        seen, made = listener.reader(topics.DETECTIONS), listener.reader(topics.POSE)
        view_intake, pose_intake = Intake(DETECTIONS_TYPE, detections_from_message), Intake(POSE_TYPE, pose_from_message)
        while max(poses, *views.values()) > 0:
            assert time.monotonic() < end, f"still to come: {views}, {poses} poses"
            listener.wait(0.2)
            for sample in seen.take():
                views[view_intake.take(sample.raw)[0].camera] -= 1
            poses -= sum(len(pose_intake.take(sample.raw)[0].person_id) > 0 for sample in made.take())


def test_two_camera_nodes_and_a_fusion_node_make_poses(demo_session: Path) -> None:
    oracle = ["--set", "detector.name=oracle", "--set", f"detector.options.truth={demo_session / 'truth' / 'truth.npz'}"]
    # played again and again: a slow machine may need any time to begin
    shared = ["--loop", "10", *oracle]
    nodes = [node("fusion", demo_session)]
    try:
        for name, cameras in (("a", ("cam00", "cam02")), ("b", ("cam01", "cam03"))):
            sources = [part for camera in cameras for part in ("--source", f"{camera}=sim:{demo_session}")]
            nodes.append(node("camera", demo_session, "--name", name, *shared, *sources))
        for running, words in zip(nodes, ("first view", "in process", "in process"), strict=True):
            running.err.wait_for(words, PATIENCE_S)
        wait_until_received(dict.fromkeys(("cam00", "cam01", "cam02", "cam03"), 60), poses=60)
        figures, *sent = [stopped(running) for running in nodes]
    finally:
        for running in nodes:
            running.process.kill()
    assert figures["poses_with_people"] > 50
    assert all(camera["used"] > 20 for camera in figures["cameras"].values())
    assert figures["messages"]["refused"] == 0
    assert all(count > 20 for one in sent for count in one["sent"].values())


def intake_of(rig: Rig, network: Network = NETWORK) -> NetworkViews:
    return NetworkViews(rig, network, SessionClock.begin(), LiveConfig())


def send_views(node: RosNode, *views: tuple[str, int, float]) -> None:
    """Of (camera, number of people, score)."""
    for camera, people, score in views:
        view = built.detections(camera, np.ones((people, len(COCO17), 2)), time.time_ns(), score=score)
        node.publish(topics.DETECTIONS, message_from_detections(view, {}), view.t_ns)
    time.sleep(0.05)


def test_strangers_are_counted_and_never_handed_on(ring_rig) -> None:
    network = replace(NETWORK, domain_id=DOMAIN + 1)
    intake, offsets = intake_of(ring_rig(2), network), JointCentres(made_by="a test", offsets={"hip": {"up": 0.01}})
    table = LiveJointCentres(t_ns=time.time_ns(), cameras=("cam00",), table=offsets)
    counts, senders = intake.views.intake.counts, intake.views.senders
    with closing(intake), RosNode("stranger", network) as stranger:
        stranger.publish(topics.JOINT_CENTRES, message_from_joint_centres(table), table.t_ns)
        until(
            lambda: counts.refused and sum(senders.strangers.values()) > 30,
            lambda: send_views(stranger, ("cam00", 0, 0.0), ("elsewhere", 0, 0.0), ("cam01", 1, 7.0)),
        )
        assert intake._chosen.wait(1.0)
        got = [*intake.messages()]
    assert "elsewhere" in senders.strangers and "scores in 0..1" in counts.last_refusal
    assert senders.skeleton == COCO17
    assert [message for message in got if isinstance(message, LiveJointCentres)] == [table]
    assert {seen.detections.camera for seen in got if isinstance(seen, SeenView)} == {"cam00"}


def test_a_second_participant_does_not_get_a_camera_while_the_first_pauses(ring_rig) -> None:
    network = replace(NETWORK, domain_id=DOMAIN + 2)
    intake = intake_of(ring_rig(2), network)
    senders = intake.views.senders

    def send(node: RosNode, wanted: Callable[[], bool]) -> None:
        until(wanted, lambda: send_views(node, ("cam00", 0, 0.0)))

    with closing(intake), RosNode("second", network) as second:
        with RosNode("first", network) as first:
            send(first, lambda: bool(senders.sender("cam00")))
            name = senders.sender("cam00")
            time.sleep(1.5)
            send(second, lambda: any("a second sender" in line for line in senders.refused))
            assert senders.sender("cam00") == name
        # the first one has left the network
        send(second, lambda: senders.sender("cam00") not in ("", None, name))


@pytest.mark.parametrize("ahead_s", [0, 3, -3])
def test_cameras_of_another_machine_look_for_people_who_are_not_sure_enough_to_be_shown(ring_rig, ahead_s) -> None:
    """Also where the clock of that machine is far off."""
    rig, clock, expected = ring_rig(3), SessionClock.begin(), []
    where = {"domain_id": DOMAIN + 2, "local_only": True}
    output = Ros2Config(**where).build()
    groups = SimpleNamespace(expect=expected.append, channels=list, messages=list, troubles=dict)
    output.take(LiveStart(t_ns=clock.now_ns(), rig=rig, rate_hz=100.0, clock_offset_ns=0))
    outlets, unsure = KeptOutputs(output), StillPerson(np.ones((len(COCO17), 3)), COCO17, sigma_m=0.5)
    fusion = Fusion(rig, Estimator(unsure, Centring(rig.names, False)), lambda _: None, clock, outlets)
    with RosNode("camera", Network(**where)) as node:
        theirs = SimpleNamespace(now_ns=lambda: clock.now_ns() + ahead_s * 1_000_000_000)
        cameras = CameraNode(rig, rig.names, node, theirs, COCO17)
        until(lambda: expected, lambda: (fusion.tick(clock.now_ns(), 10_000_000), cameras.step(groups)))
    output.close()
    assert abs(expected[-1].t_ns - theirs.now_ns()) < 1_500_000_000
    assert all(len(pose.person_id) == 0 for pose in outlets.poses())
    assert np.allclose(expected[-1].xyz_world, 1.0)


# --- intrinsics that camera nodes send to the fusion node


def longer(rig, by):
    """The rig with all focal lengths longer."""
    K = np.diag([by, by, 1.0])
    return replace(rig, cameras=tuple(replace(camera, K=camera.K @ K) for camera in rig))


def test_a_node_with_other_intrinsics_is_reported(ring_rig):
    rig = ring_rig(2)
    intake, found = intake_of(rig), []
    with closing(intake), RosNode("cameras_a", NETWORK) as a:
        publish_intrinsics(a, longer(rig, 1.05), ["cam01"], 0)
        small = replace(rig["cam00"], size_wh=(320, 200))
        a.publish(topics.node_camera_info("cam00"), info_from_camera(small, 0), 0)
        until(lambda: len(found) > 1, lambda: found.extend(intake.notices()))
    # they come in any order
    small_one, long_one = sorted(found)
    assert "camera cam00: intrinsics of its node: expected images of (640, 480) px as in the rig, got (320, 200)" in small_one
    assert long_one.startswith("camera cam01: its node works with other intrinsics than the rig here (up to")


def test_a_network_that_cannot_be_read_for_a_while_is_reported_once_and_read_again(ring_rig, monkeypatch):
    intake, rig = intake_of(ring_rig(2)), ring_rig(2)
    # each kind is reported once, whatever its words are
    failures = iter([SourceError("no buffer space"), ValueError("no buffer space"), SourceError("no route"), ValueError("none")])
    hand_on = NetworkViews._hand_on

    def failing(self):
        if (error := next(failures, None)) is not None:
            raise error
        hand_on(self)

    monkeypatch.setattr(NetworkViews, "_hand_on", failing)
    found: list[str] = []
    with closing(intake), RosNode("cameras_a", NETWORK) as a:
        publish_intrinsics(a, longer(rig, 1.05), ["cam01"], 0)
        until(lambda: len(found) >= 3, lambda: found.extend(intake.notices()))
    assert found[:2] == [f"the network cannot be read ({kind}: no buffer space)" for kind in ("SourceError", "ValueError")]
    assert found[2].startswith("camera cam01: its node works with other intrinsics")
