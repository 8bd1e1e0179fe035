"""Intrinsics that camera nodes tell the fusion node, over the loopback device."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from own_domain import own_domain

pytest.importorskip("cyclonedds")

from posefuse.core import SourceError
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.messages import SessionClock
from posefuse_ros import topics
from posefuse_ros.camera_messages import info_from_camera
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network
from posefuse_ros.network_views import NetworkViews
from posefuse_ros.node_cameras import publish_intrinsics, rig_of_nodes

pytestmark = pytest.mark.realtime
NETWORK = Network(domain_id=own_domain(), local_only=True)


def longer(rig, by):
    """The rig with all focal lengths longer."""
    K = np.diag([by, by, 1.0])
    return replace(rig, cameras=tuple(replace(camera, K=camera.K @ K) for camera in rig))


def test_the_fusion_works_with_the_intrinsics_of_the_nodes(ring_rig):
    rig = ring_rig(2)
    theirs, said = longer(rig, 1.05), []
    with RosNode("cameras_a", NETWORK) as a, RosNode("cameras_b", NETWORK) as b:
        publish_intrinsics(a, theirs, ["cam00"], time.time_ns())
        small = replace(rig["cam01"], size_wh=(320, 200))
        b.publish(topics.node_camera_info("cam01"), info_from_camera(small, 0), 0)
        # what cannot be used is waited past
        timer = threading.Timer(2.0, publish_intrinsics, (b, theirs, ["cam01"], time.time_ns()))
        timer.start()
        found = rig_of_nodes(rig, NETWORK, said.append, 30.0)
        timer.join(30.0)
    for camera in found:
        np.testing.assert_array_equal(camera.K, theirs[camera.name].K)
        np.testing.assert_array_equal(camera.cam_from_world.matrix4(), rig[camera.name].cam_from_world.matrix4())
    assert said == ["intrinsics of cam00, cam01 are those that their nodes work with"]


def test_a_camera_that_no_node_sends_is_named(ring_rig):
    rig = ring_rig(2)
    with RosNode("cameras_a", NETWORK) as a:
        publish_intrinsics(a, rig, ["cam00"], 0)
        with pytest.raises(SourceError, match=r"intrinsics of cam01 were not received from any camera node within 1 s"):
            rig_of_nodes(rig, NETWORK, lambda line: None, 1.0)


def test_a_node_with_other_intrinsics_is_reported(ring_rig):
    rig = ring_rig(2)
    intake = NetworkViews(rig, NETWORK, SessionClock.begin(), LiveConfig())
    try:
        with RosNode("cameras_a", NETWORK) as a:
            publish_intrinsics(a, longer(rig, 1.05), ["cam01"], 0)
            publish_intrinsics(a, rig, ["cam00"], 0)
            end_s, found = time.monotonic() + 20, []
            while not found and time.monotonic() < end_s:
                time.sleep(0.1)
                found = intake.notices()
    finally:
        intake.close()
    assert len(found) == 1 and found[0].startswith("camera cam01: its node works with other intrinsics than the rig here (up to")


def test_a_network_that_cannot_be_read_for_a_while_is_reported_once_and_read_again(ring_rig, monkeypatch):
    intake, rig = NetworkViews(ring_rig(2), NETWORK, SessionClock.begin(), LiveConfig()), ring_rig(2)
    failures = iter([SourceError("no buffer space"), ValueError("no buffer space")] * 2)
    hand_on = NetworkViews._hand_on

    def failing(self):
        if (error := next(failures, None)) is not None:
            raise error
        hand_on(self)

    monkeypatch.setattr(NetworkViews, "_hand_on", failing)
    found: list[str] = []
    try:
        with RosNode("cameras_a", NETWORK) as a:
            publish_intrinsics(a, longer(rig, 1.05), ["cam01"], 0)
            end_s = time.monotonic() + 20
            while len(found) < 3 and time.monotonic() < end_s:
                time.sleep(0.1)
                found += intake.notices()
    finally:
        intake.close()
    assert found[:2] == [f"the network cannot be read ({kind}: no buffer space)" for kind in ("SourceError", "ValueError")]
    assert found[2].startswith("camera cam01: its node works with other intrinsics")
