"""Cameras of a simulator: stamps in simulated time, CameraInfo next to the images; sent by another process on loopback."""

import time

import numpy as np
import pytest
from checks import refusal
from own_domain import own_domain

pytest.importorskip("cyclonedds", reason="the extra `ros` is not installed")

from posefuse.core import ConfigError, MessageError, SourceError
from posefuse.realtime.inputs import inputs_from_arguments, rig_of_inputs
from posefuse_ros.camera_info import apart_px, camera_of_info, info_topic
from posefuse_ros.camera_messages import info_from_camera
from posefuse_ros.source import RosConfig

DOMAIN = own_domain()


def test_simulated_stamps_come_as_times_of_this_machine(sender):
    config = RosConfig(topic="/cam00/image_raw", camera="cam00", domain_id=DOMAIN, local_only=True, wait_s=60, sim_time=True)
    source = config.build()
    frames = source.frames()
    got = np.array([(next(frames).t_ns, time.time_ns()) for _ in range(45)])[5:]
    source.close()
    # stamps are set when images are sent, just before they arrive, and pass as fast; simulated time passes half as fast
    stamped_ns, arrived_ns = np.ptp(got, axis=0)
    assert stamped_ns / arrived_ns == pytest.approx(1.0, abs=0.3)
    assert abs(np.median(got[:, 0] - got[:, 1])) < 2_000_000_000


def test_camera_infos_are_compared_with_the_rig_or_taken(sender, ring_rig):
    rig = ring_rig(4)
    ros = {"domain_id": DOMAIN, "local_only": True}
    inputs = inputs_from_arguments([f"{name}=ros:/{name}/image_raw" for name in rig.names], rig, ros)
    said: list[str] = []
    for _ in range(20):
        # a loaded machine may need longer than is waited for
        said.clear()
        assert rig_of_inputs(rig, inputs, "check", said.append) is rig
        if len(said) == 3:
            break
    assert [line.split(":")[0] for line in said] == ["camera cam01", "camera cam02", "camera cam03"]
    assert "focal length 604.8 px, rig 576.0 px" in said[0]
    assert "holds no calibration" in said[1]
    assert "nothing came within 2 s" in said[2]
    with pytest.raises(SourceError, match="camera cam02: its intrinsics are wanted from /cam02/camera_info, but it holds no"):
        rig_of_inputs(rig, inputs[1:3], "use", said.append)
    taken = rig_of_inputs(rig, inputs[:2], "use", said.append)
    np.testing.assert_array_equal(taken["cam01"].K, sender.K)
    assert taken["cam01"].cam_from_world is rig["cam01"].cam_from_world
    assert taken.names == rig.names
    assert rig_of_inputs(rig, inputs, "ignore", said.append) is rig


def test_lenses_are_compared_over_the_whole_image(ring_rig):
    plain, bent = ring_rig(1).cameras[0], ring_rig(1, distortion=(-0.1, 0.0, 0.0, 0.0)).cameras[0]
    assert apart_px(plain, plain) == 0
    corner = np.array([[0.0, 0.0]])
    expected = np.linalg.norm(bent.px_from_norm(plain.norm_from_px(corner)) - corner)
    assert apart_px(plain, bent) == pytest.approx(expected)
    assert expected > 10


def test_what_cannot_be_the_camera_is_refused(ring_rig):
    camera = ring_rig(1).cameras[0]
    with pytest.raises(MessageError, match="images are 320x240 px, the rig was calibrated at 640x480"):
        camera_of_info(camera, info_from_camera(camera.scaled((320, 240)), 0))


@pytest.mark.parametrize(
    ("image", "info"),
    [("/a/image_raw", "/a/camera_info"), ("/a/b/image_rect/compressed", "/a/b/camera_info"), ("/image", "/camera_info")],
)
def test_camera_info_lies_next_to_the_image(image, info):
    assert info_topic(image) == info


def test_the_network_reaches_the_sources(ring_rig):
    import posefuse as pf

    ros = {"domain_id": 7, "local_only": False, "peers": ["10.0.0.2"], "interface": "eth9", "sim_time": True}
    session = pf.live(ring_rig(2), {"cam00": "ros:/a/image_raw", "cam01": "ros:/b/image_raw"}, ros=ros)
    for entry in session._plan.inputs:
        network = entry.config.network
        assert (network.domain_id, network.interface, network.peers) == (7, "eth9", ("10.0.0.2",))
        assert not network.local_only and entry.config.sim_time
    for wrong in ({"domain": 7}, {"peers": "10.0.0.2"}):
        refusal(ConfigError, r"^ros: ", pf.live, ring_rig(2), {"cam00": "ros:/a/image_raw"}, ros=wrong)
