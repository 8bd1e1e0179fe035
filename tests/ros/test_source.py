"""Image topics of ROS 2, of cameras and of simulators: sent by another process on loopback; simulated time, ideal images."""

import threading
import time
from contextlib import closing, nullcontext
from dataclasses import replace
from itertools import islice, takewhile
from types import SimpleNamespace

import built
import numpy as np
import pytest
from checks import refusal
from live_session import until
from own_domain import own_domain

pytest.importorskip("cyclonedds", reason="the extra `ros` is not installed")

from cyclonedds.core import DDSException

import posefuse as pf
from posefuse.core import SE3, Camera, ConfigError, MessageError, SourceError
from posefuse.core.ideal_image import drawn_camera
from posefuse.evaluation.contracts import check_source
from posefuse.realtime.inputs import compare_rig, inputs_from_arguments
from posefuse_ros.camera_info import RigLens, apart_px, camera_of_info, info_topic, is_ideal_image_of
from posefuse_ros.camera_messages import IMAGE_TYPE, info_from_camera
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network
from posefuse_ros.messages import time_from_ns
from posefuse_ros.sim_time import ClockReader, SimulatedClock
from posefuse_ros.source import RosConfig, RosSource
from posefuse_ros.topics import CLOCK, Topic
from posefuse_ros.types import message

DOMAIN = own_domain()


WHERE = {"domain_id": DOMAIN, "local_only": True}
NETWORK = Network(**WHERE)


def config(topic, wait_s=60.0, **more):
    return RosConfig(topic=topic, camera="cam02", wait_s=wait_s, **WHERE, **more)


def why_refused(topic, wanted):
    """What `build` says of a topic, given longer as long as it has not yet heard of the one it is to name."""
    for wait_s in (1.0, 2.0, 5.0, 20.0):
        with pytest.raises(SourceError) as caught:
            config(topic, wait_s).build()
        if wanted in str(caught.value):
            break
    return str(caught.value)


@pytest.mark.parametrize("topic", ["/cam/image_raw", "/cam/image_raw/compressed"])
def test_it_keeps_the_contract_of_sources(sender, topic):
    source = config(topic).build()
    assert source.size_wh == (16, 12)
    frame = next(source.frames())
    assert 0 <= frame.t_ns - 1_700_000_000 * 10**9 < 60_000_000_000
    assert np.abs(frame.image[:, :6].astype(int) - 200).max() < 12
    check_source(source)


def test_images_of_another_size_or_older_are_refused_and_counted(sender):
    source = config("/cam/image_raw").build()
    frames = source.frames()
    # a slow reader loses messages, so it takes as many as it needs
    got = list(takewhile(lambda frame: source.refused_frames <= 5, islice(frames, 1000)))
    assert {f.size_wh for f in got} == {(16, 12)}
    assert source.refused_frames > 5
    source.close()
    assert source.last_refusal.startswith("topic /cam/image_raw: ")


@pytest.mark.parametrize("jump_s", [-7200, 7200])
def test_a_clock_that_is_set_shows_in_the_stamps_only(sender, monkeypatch, jump_s):
    real = time.time_ns
    with closing(config("/cam/image_raw").build()) as source:
        frames = source.frames()
        before = next(frames).received_ns
        monkeypatch.setattr(time, "time_ns", lambda: real() + jump_s * 10**9)
        later = [frame.received_ns - before for frame in islice(frames, 20)]
    assert 0 < later[-1] < 600e9


def test_closing_ends_the_frames(sender):
    source = config("/cam/image_raw").build()
    thread = threading.Thread(target=lambda: list(source.frames()))
    thread.start()
    source.close()
    thread.join(timeout=20)
    assert not thread.is_alive()


def test_what_is_closed_while_another_thread_uses_it_ends_quietly(monkeypatch):
    with RosNode("closed", NETWORK) as node:

        def wait(_: int) -> int:
            node.close()
            raise DDSException(-12, msg="Occurred while waiting")

        node._waitset = SimpleNamespace(wait=wait)
        assert node.wait(1.0) is False
    source = object.__new__(RosSource)
    source._closed, source._seq = False, 5
    source._first = built.frame()

    def gone() -> list:
        source._closed = True
        raise SourceError("Cyclone DDS could not read")

    monkeypatch.setattr(source, "_take", gone, raising=False)
    assert list(source.frames()) == []


@pytest.mark.parametrize(
    ("topic", "words"),
    [
        ("/cam2/image_raw", f"image topics in domain {DOMAIN}: /cam/image_raw, /cam/image_raw/compressed"),
        ("/chatter", "it carries std_msgs/msg/String, expected sensor_msgs/msg/Image"),
    ],
    # a domain is each worker's own, and may not be part of a test's name
    ids=("missing", "another type"),
)
def test_a_missing_topic_or_one_of_another_type_is_reported(sender, topic, words):
    assert words in why_refused(topic, words)


def test_an_overtaken_image_is_refused_and_a_clock_that_was_set_back_costs_none():
    source = object.__new__(RosSource)
    source._newest_ns, source._topic, source.size_wh = 100_000_000_000, Topic("/cam/image_raw", IMAGE_TYPE), (4, 3)
    for late_s, taken in ((0.0, False), (0.5, False), (5.0, True)):
        t_ns = source._newest_ns - round(late_s * 1e9)
        frame = built.frame("cam02", t_ns, np.zeros((3, 4, 3), np.uint8))
        with nullcontext() if taken else pytest.raises(SourceError, match="not newer"):
            source._check(frame)


# --- cameras of a simulator: stamps in simulated time, CameraInfo next to the images


def test_simulated_stamps_come_as_times_of_this_machine(sender):
    source = config("/cam00/image_raw", sim_time=True).build()
    frames = source.frames()
    got = np.array([(next(frames).t_ns, time.time_ns()) for _ in range(45)])[5:]
    source.close()
    # stamps are set when images are sent, just before they arrive, and pass as fast; simulated time passes half as fast
    stamped_ns, arrived_ns = np.ptp(got, axis=0)
    assert stamped_ns / arrived_ns == pytest.approx(1.0, abs=0.3)
    assert abs(np.median(got[:, 0] - got[:, 1])) < 2_000_000_000


def test_camera_infos_are_compared_with_the_rig(sender, ring_rig):
    rig = ring_rig(4)
    inputs = inputs_from_arguments([f"{name}=ros:/{name}/image_raw" for name in rig.names], rig, WHERE)
    said: list[str] = []

    def check() -> None:
        said.clear()
        compare_rig(rig, inputs, said.append)

    # a loaded machine may need longer than is waited for
    until(lambda: len(said) == 3, check)
    assert [line.split(":")[0] for line in said] == ["camera cam01", "camera cam02", "camera cam03"]
    assert "focal length 604.8 px, rig 576.0 px" in said[0]
    assert "holds no calibration" in said[1]
    assert "nothing came within 2 s" in said[2]


def test_lenses_are_compared_over_the_whole_image(ring_rig):
    plain, bent = ring_rig(1).cameras[0], ring_rig(1, distortion=(-0.1, 0.0, 0.0, 0.0)).cameras[0]
    assert apart_px(plain, plain) == 0
    corner = np.zeros((1, 2))
    expected = np.linalg.norm(bent.px_from_norm(plain.norm_from_px(corner)) - corner)
    assert apart_px(plain, bent) == pytest.approx(expected) and expected > 10


@pytest.mark.parametrize(
    ("image", "info"),
    [("/a/image_raw", "/a/camera_info"), ("/a/b/image_rect/compressed", "/a/b/camera_info"), ("/image", "/camera_info")],
)
def test_camera_info_lies_next_to_the_image(image, info):
    assert info_topic(image) == info


def test_the_network_reaches_the_sources(ring_rig):
    ros = {"domain_id": 7, "local_only": False, "peers": ["10.0.0.2"], "interface": "eth9", "sim_time": True}
    session = pf.live(ring_rig(2), {"cam00": "ros:/a/image_raw", "cam01": "ros:/b/image_raw"}, ros=ros)
    for entry in session._plan.inputs:
        network = entry.config.network
        assert (network.domain_id, network.interface, network.peers) == (7, "eth9", ("10.0.0.2",))
        assert not network.local_only and entry.config.sim_time
    for wrong in ({"domain": 7}, {"peers": "10.0.0.2"}):
        refusal(ConfigError, r"^ros: ", pf.live, ring_rig(2), {"cam00": "ros:/a/image_raw"}, ros=wrong)


# --- simulated time against real time, whatever speed the simulator runs at


S = 1_000_000_000


def heard(clock, rate, seconds, sim0_ns=0, real0_ns=10**18, jitter_ns=0, every_s=0.01, seed=0):
    rng = np.random.default_rng(seed)
    for i in range(round(seconds / every_s)):
        real_ns = real0_ns + round(i * every_s * S)
        clock.add(sim0_ns + round(i * every_s * S * rate), real_ns + round(rng.uniform(0, jitter_ns)))
    return real0_ns + round(seconds * S)


@pytest.mark.parametrize("rate", [0.1, 0.7, 1.0, 3.0])
def test_both_directions_undo_each_other_at_any_speed(rate):
    clock = SimulatedClock()
    end_ns = heard(clock, rate, 3.0)
    for real_ns in (end_ns - S // 3, end_ns, end_ns + S // 20):
        sim_ns = clock.sim_from_real(real_ns)
        assert sim_ns == pytest.approx((real_ns - 10**18) * rate, abs=2000)
        assert abs(clock.real_from_sim(sim_ns) - real_ns) <= 1000


def test_jitter_of_the_network_is_smoothed():
    clock = SimulatedClock()
    heard(clock, 0.5, 3.0, jitter_ns=4_000_000)
    off_ns = clock.real_from_sim(round(1.45 * S)) - (10**18 + round(2.9 * S))
    # on average a message is 2 ms late; one alone would be up to 4 ms
    assert 1_000_000 < off_ns < 3_000_000


def test_a_change_of_speed_is_followed_within_a_second():
    clock = SimulatedClock()
    end_ns = heard(clock, 1.0, 2.0)
    end_ns = heard(clock, 0.25, 1.2, sim0_ns=2 * S, real0_ns=end_ns)
    assert clock.sim_from_real(end_ns) == pytest.approx(2.3 * S, abs=1e6)


def test_a_simulation_that_pauses_or_restarts_is_followed_immediately():
    clock = SimulatedClock()
    end_ns = heard(clock, 0.5, 2.0)
    clock.add(clock.sim_from_real(end_ns - S // 100), end_ns)
    for i in range(20):
        clock.add(S, end_ns + i * S // 10)
    assert clock.sim_from_real(end_ns + 19 * S // 10) == S
    clock.add(0, end_ns + 2 * S)
    assert clock.real_from_sim(0) == end_ns + 2 * S


def test_a_node_that_receives_no_clock_reports_it():
    # where no sender runs
    with RosNode("sim", replace(NETWORK, domain_id=DOMAIN + 1)) as node:
        reader = ClockReader(node)
        refusal(SourceError, "nothing came on /clock", reader.wait, 0.05)
        seven = message(CLOCK.type_name, clock=time_from_ns(7 * S + 5))
        until(lambda: reader.clock.known, lambda: (node.publish(CLOCK, seven, 0), reader.update()))
        sim_ns = reader.clock.sim_from_real(time.time_ns())
        assert 7 * S <= sim_ns < 9 * S


# --- ideal images of a simulator get the lens of the rig's camera


BENT = Camera(
    name="cam",
    size_wh=(240, 180),
    K=np.array([[210.0, 0, 118], [0, 205, 92], [0, 0, 1]]),
    cam_from_world=SE3.identity(),
    distortion=np.array([-0.25, 0.08, 0.002, -0.001, 0.0]),
)


def picture(camera: Camera) -> np.ndarray:
    """What a camera sees of a smooth pattern at infinity: red and green are x/z and y/z."""
    columns, rows = np.meshgrid(np.arange(camera.size_wh[0]), np.arange(camera.size_wh[1]))
    norm = camera.norm_from_px(np.stack([columns, rows], axis=-1))
    return np.concatenate([128 + 100 * norm, np.zeros((*norm.shape[:2], 1))], axis=-1)


def test_an_ideal_image_becomes_the_cameras_own():
    lens, drawn = RigLens(BENT), drawn_camera(BENT)
    assert drawn.size_wh != BENT.size_wh and lens.ideal_wh == drawn.size_wh
    taken_in = lens(picture(drawn).astype(np.float32))
    # a grey level of 100 per unit of x/z, some 210 px: a fifth of a pixel is 0.1
    assert np.abs(taken_in - picture(BENT)).max() < 0.05


def test_an_image_of_the_cameras_size_stays_and_any_other_is_refused():
    lens = RigLens(BENT)
    image = np.zeros((180, 240, 3), np.uint8)
    assert lens(image) is image
    wrong = r"expected images of 240x180 px, or \d+x\d+ of an ideal camera, got 100x50"
    refusal(SourceError, wrong, lens, np.zeros((50, 100, 3), np.uint8))


def test_the_camera_info_of_a_simulator_confirms_the_rig():
    drawn = drawn_camera(BENT)
    # pixels counted from the edge of the image
    stated = replace(drawn, K=drawn.K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]))
    assert is_ideal_image_of(BENT, stated)
    assert camera_of_info(BENT, info_from_camera(stated, 0)) is BENT
    other = replace(stated, K=stated.K * np.array([[1.01, 1, 1], [1, 1.01, 1], [1, 1, 1]]))
    assert not is_ideal_image_of(BENT, other)
    refusal(MessageError, "images are", lambda: camera_of_info(BENT, info_from_camera(other, 0)))
    small = info_from_camera(BENT.scaled((120, 90)), 0)
    refusal(MessageError, "images are 120x90 px, the rig was calibrated at 240x180", lambda: camera_of_info(BENT, small))


@pytest.mark.parametrize(
    "camera",
    [
        BENT,
        replace(BENT, distortion=np.array([0.15, -0.02, 0.0, 0.001])),
        replace(BENT, distortion=np.zeros(0), K=BENT.K + np.array([[0, 2.0, 0], [0, 0, 0], [0, 0, 0]])),
        replace(BENT, distortion=np.array([0.02, -0.01, 0.001, 0.0]), model="fisheye"),
    ],
    ids=["barrel", "pincushion", "skew", "fisheye"],
)
def test_the_ideal_camera_sees_all_that_the_lens_sees(camera):
    drawn = drawn_camera(camera)
    corners = np.array([[0, 0], [camera.size_wh[0] - 1, 0], [0, camera.size_wh[1] - 1], np.array(camera.size_wh) - 1], float)
    seen = drawn.px_from_norm(camera.norm_from_px(corners))
    assert (seen > 0).all() and (seen < np.array(drawn.size_wh) - 1).all()
