"""One session on two machines, here two processes on the loopback device."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from posefuse.app.live.clock import SessionClock
from posefuse.app.live.config import LiveConfig
from posefuse.app.live.network_intake import NetworkIntake
from posefuse.app.live.session import ready_tracker
from posefuse.core import SKELETONS, Detections2D
from posefuse.files.rig import read_rig

pytest.importorskip("cyclonedds")
# apart from what tests of `wire` use, and from another run on this machine
DOMAIN = 10 + os.getpid() % 80


def node(part: str, session: Path, *options: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "posefuse.app.cli", "node", part, str(session / "rig.toml"), "--json"]
    command += ["--local-only", "--domain", str(DOMAIN), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture(scope="module")
def compiled(demo_session: Path) -> None:
    """The kernels are on disk: on a new machine a fusion node compiles longer than these camera nodes play."""
    ready_tracker(read_rig(demo_session / "rig.toml"), SKELETONS["anatomical23"], LiveConfig())


@pytest.mark.usefixtures("compiled")
def test_two_camera_nodes_and_a_fusion_node_make_poses(demo_session: Path) -> None:
    oracle = ["--set", "detector.name=oracle", "--set", f"detector.options.truth={demo_session / 'truth' / 'truth.npz'}"]
    zero = str(time.time() + 6)
    fusion = node("fusion", demo_session, "--duration", "9")
    cameras = [
        node("camera", demo_session, "--name", name, "--zero", zero, "--duration", "11", *oracle, *sources)
        for name, sources in (
            ("a", ("--source", f"cam00=sim:{demo_session}", "--source", f"cam02=sim:{demo_session}")),
            ("b", ("--source", f"cam01=sim:{demo_session}", "--source", f"cam03=sim:{demo_session}")),
        )
    ]
    out, err = fusion.communicate(timeout=90)
    ends = [camera.communicate(timeout=60) for camera in cameras]
    assert fusion.returncode == 0, err
    assert all(camera.returncode == 0 for camera in cameras), ends
    figures = json.loads(out)
    assert figures["poses_with_people"] > 50
    assert all(camera["used"] > 20 for camera in figures["cameras"].values())
    assert figures["messages"]["refused"] == 0


def test_strangers_are_counted_and_never_handed_on(ring_rig) -> None:
    from posefuse.wire import topics
    from posefuse.wire.dds import Network, RosNode
    from posefuse.wire.messages import message_from_detections

    skeleton = SKELETONS["coco17"]
    network = Network(DOMAIN + 1, local_only=True)
    intake = NetworkIntake(ring_rig(2), network, SessionClock.begin())
    try:
        with RosNode("stranger", network) as stranger:
            writer = stranger.writer(topics.DETECTIONS)
            end = time.monotonic() + 20
            while (
                not (intake.intake.counts.refused and intake.strangers and intake.intake.counts.accepted > 2)
                and time.monotonic() < end
            ):
                for camera in ("cam00", "elsewhere"):
                    view = Detections2D.nobody(camera, time.time_ns(), skeleton)
                    stranger.publish(topics.DETECTIONS, message_from_detections(view, {}), view.t_ns)
                broken = Detections2D(
                    "cam01", time.time_ns(), skeleton, np.full((1, 17, 2), np.nan), np.full((1, 17), 7.0),
                    np.ones((1, 17)), np.zeros((1, 4)),
                )  # fmt: skip
                stranger.publish(topics.DETECTIONS, message_from_detections(broken, {}), broken.t_ns)
                time.sleep(0.05)
            assert writer.readers() > 0
        got = list(intake.messages())
    finally:
        intake.close()
    assert "elsewhere" in intake.strangers
    assert "scores in 0..1" in intake.intake.counts.last_refusal
    assert {seen.detections.camera for seen in got} == {"cam00"}
