"""Streams of the Lab Streaming Layer, read back by LSL's own inlet on this machine."""

import os
import time
from dataclasses import replace

import numpy as np
import pytest
from made_up_session import RATE_HZ, made_up_messages, made_up_start

from posefuse.core import LivePose
from posefuse.outputs.live import LslConfig
from posefuse.outputs.live.lsl import angle_sample, chosen_person, keypoint_channels, keypoint_sample, lsl_clock_offset_ns

PATIENCE_S = 20.0
POSES = [message for message in made_up_messages() if isinstance(message, LivePose)]
PAIR = next(message for message in POSES if len(message.pose.person_id) == 2 and message.joints is not None)


@pytest.fixture
def lsl():
    try:
        import pylsl
    except (ImportError, RuntimeError, OSError) as error:
        pytest.skip(f"the extra lsl is not usable here: {error}")
    return pylsl


def inlet_of(lsl, name: str):
    found = lsl.resolve_byprop("name", name, minimum=1, timeout=PATIENCE_S)
    if not found:
        pytest.skip("LSL finds no stream on this machine: no multicast on any network interface")
    inlet = lsl.StreamInlet(found[0])
    inlet.open_stream(PATIENCE_S)
    return inlet


def sample_of(inlet):
    sample, t_s = inlet.pull_sample(timeout=PATIENCE_S)
    assert sample is not None, "no sample came"
    return np.array(sample), t_s


def test_an_inlet_gets_keypoints_and_angles_with_names_units_and_time(lsl) -> None:
    config = LslConfig(stream=f"test {os.getpid()}")
    output, start = config.build(), made_up_start(1)
    output.take(start)
    # the first pose announces the streams; who connects then gets what follows
    output.take(PAIR)
    keypoints, angles = inlet_of(lsl, f"{config.stream} keypoints"), inlet_of(lsl, f"{config.stream} joint angles")
    before_s = lsl.local_clock()
    now_ns = time.monotonic_ns() + start.clock_offset_ns
    after_s = lsl.local_clock()
    shown = replace(PAIR, pose=replace(PAIR.pose, t_ns=now_ns))
    output.take(shown)
    sample, t_s = sample_of(keypoints)
    # session time on LSL's clock, within what reading two clocks takes
    assert before_s - 1e-3 < t_s < after_s + 1e-3
    np.testing.assert_array_equal(sample, keypoint_sample(shown.pose, 7))
    angle, angle_t_s = sample_of(angles)
    np.testing.assert_array_equal(angle, angle_sample(shown.joints, 7))
    assert angle_t_s == t_s
    info = keypoints.info()
    labels = info.get_channel_labels()
    assert labels[:5] == ["nose_x", "nose_y", "nose_z", "nose_sigma", f"{PAIR.pose.skeleton.keypoints[1]}_x"]
    assert (labels[-1], len(labels)) == ("person_id", 4 * len(PAIR.pose.skeleton) + 1)
    assert set(info.get_channel_units()[:-1]) == {"meters"}
    # ticks may be skipped: readers of XDF would lay samples of a regular rate on one line
    assert (info.type(), info.nominal_srate()) == ("MoCap", lsl.IRREGULAR_RATE)
    assert float(info.desc().child("acquisition").child_value("rate_hz")) == RATE_HZ
    assert info.desc().child("acquisition").child_value("skeleton") == PAIR.pose.skeleton.name
    assert info.desc().child("acquisition").child_value("rig_id") == start.rig.id
    info = angles.info()
    knee = info.get_channel_labels().index("left_knee/flexion")
    assert info.get_channel_labels()[knee + 1] == "left_knee/flexion_sigma"
    assert info.get_channel_units()[knee] == "radians"
    joint = PAIR.joints.joints.index("left_knee")
    part = PAIR.joints.angle_names[joint].index("flexion")
    np.testing.assert_equal(angle[knee], PAIR.joints.angle_rad[-1, 0, joint, part])
    output.close()


def test_the_clocks_differ_by_a_constant(lsl) -> None:
    offsets = [lsl_clock_offset_ns() for _ in range(20)]
    assert max(offsets) - min(offsets) < 1_000_000


def test_a_sample_has_every_keypoint_and_nan_where_there_is_none() -> None:
    labels, units = keypoint_channels(PAIR.pose.skeleton.keypoints)
    sample = dict(zip(labels, keypoint_sample(PAIR.pose, 8), strict=True))
    name, missing = PAIR.pose.skeleton.keypoints[5], PAIR.pose.skeleton.keypoints[3]
    np.testing.assert_array_equal([sample[f"{name}_{axis}"] for axis in "xyz"], PAIR.pose.xyz_world[1, 5])
    assert sample[f"{name}_sigma"] == pytest.approx(0.01)
    assert np.isnan([sample[f"{missing}_{part}"] for part in ("x", "y", "z", "sigma")]).all()
    assert sample["person_id"] == 8 and len(units) == len(labels)
    assert np.isnan(keypoint_sample(PAIR.pose, None)).all()
    assert np.isnan(angle_sample(PAIR.joints, None)).all()


def test_a_person_stays_chosen_while_followed() -> None:
    assert chosen_person([3, 5], None, None) == 3
    assert chosen_person([3, 5], 5, None) == 5
    assert chosen_person([3], 5, None) == 3
    assert chosen_person([], 5, None) is None
    assert chosen_person([3, 5], 3, 5) == 5
    assert chosen_person([3], 3, 5) is None
