"""Where cameras stand and look."""

import numpy as np
import pytest
from checks import refusal
from scenes import listed, scene

from posefuse.core import ConfigError
from posefuse_sim.build import shots_of
from posefuse_sim.cameras import placed_cameras, rig_from_cameras


def _ring(**content):
    return rig_from_cameras(placed_cameras(scene(cameras={"kind": "ring", **content}).cameras))


def _seen_by(xyz, **content):
    """px of a point in one camera at a place of its own."""
    return rig_from_cameras(placed_cameras(scene(cameras=listed({"name": "a", **content})).cameras)).project(np.array(xyz))[0]


def test_a_ring_looks_at_its_point_from_its_circle():
    rig = _ring(count=5, radius_m=3.0, height_m=1.7, centre_m=[0.5, -1.0], look_at_m=[0.2, 0.1, 0.9])
    centres = rig.centres_world()
    np.testing.assert_allclose(np.hypot(centres[:, 0] - 0.5, centres[:, 1] + 1.0), 3.0)
    np.testing.assert_allclose(centres[:, 2], 1.7)
    middle = np.tile([(640 - 1) / 2, (480 - 1) / 2], (5, 1))
    np.testing.assert_allclose(rig.project(np.array([0.2, 0.1, 0.9])), middle, atol=1e-9)


def test_up_is_up_in_every_picture():
    rig = _ring()
    low, high = rig.project(np.array([0, 0, 0.5])), rig.project(np.array([0, 0, 1.5]))
    assert (high[:, 1] < low[:, 1] - 50).all()
    np.testing.assert_allclose(high[:, 0], low[:, 0], atol=1e-9)


def test_the_field_of_view_is_between_the_edges():
    camera = _ring(count=1, image={"size_px": [800, 600], "horizontal_fov_deg": 70.0}).cameras[0]
    left, right = camera.norm_from_px(np.array([[-0.5, 299.5], [799.5, 299.5]]))[:, 0]
    assert np.rad2deg(np.arctan(right) - np.arctan(left)) == pytest.approx(70.0)


def test_roll_turns_the_camera_clockwise_so_the_world_turns_the_other_way():
    above = _seen_by([0.0, 0.0, 1.5], position_m=[0.0, -3.0, 1.0], look_at_m=[0.0, 0.0, 1.0], roll_deg=90.0)
    # turned clockwise by a quarter, what was up is now on the left
    assert above[0] < 300 and above[1] == pytest.approx(239.5)


def test_a_camera_may_look_straight_down():
    north = _seen_by([0.0, 0.5, 0.0], position_m=[0.0, 0.0, 3.0], look_at_m=[0.0, 0.0, 0.0])
    assert north[1] < 239 and north[0] == pytest.approx(319.5)


def test_overrides_change_one_camera_only():
    rig = _ring(count=3, overrides={"cam01": {"image": {"size_px": [320, 200]}, "sensor": {"readout_s": 0.01}}})
    assert [camera.size_wh for camera in rig] == [(640, 480), (320, 200), (640, 480)]
    assert [camera.readout_s for camera in rig] == [0.0, 0.01, 0.0]


@pytest.mark.parametrize(
    ("cameras", "message"),
    [
        ({"overrides": {"cam9": {}}}, "no camera 'cam9'; there are: cam00, cam01, cam02, cam03"),
        ({"image": {"distortion": [0.1]}}, r"camera cam00: distortion.*got 1"),
        ({"image": {"K": [[-5.0, 0, 1], [0, 5.0, 1], [0, 0, 1]]}}, "camera cam00: K: expected"),
        (listed({"name": "a", "position_m": [0, 0, 1], "look_at_m": [0, 0, 1]}), "camera a: look_at_m is its own position"),
        ({"radius_m": 1e308}, "camera cam00: expected a position within 1e.06 m of look_at_m"),
    ],
)
def test_impossible_cameras_are_refused(cameras, message):
    refusal(ConfigError, message, _ring, **cameras)


# --- clocks: what a camera exposes when, and what it writes on it


def _shots(seed=3, index=1, rate_hz=25.0, start_s=2.0, duration_s=40.0, **sensor):
    cameras = listed({"name": "left", "position_m": [3.0, 0.0, 1.0], "sensor": sensor})
    made = scene(duration_s=duration_s, start_s=start_s, rate_hz=rate_hz, seed=seed, cameras=cameras)
    return shots_of(made, index, made.cameras.cameras[0])


def test_a_perfect_camera_keeps_the_nominal_times():
    shots = _shots()
    expected = np.round((2.0 + np.arange(1000) / 25.0) * 1e9)
    np.testing.assert_array_equal(shots.t_ns, expected)
    np.testing.assert_array_equal(shots.stamp_ns, expected)
    np.testing.assert_array_equal(shots.seq, np.arange(1000))


def test_offset_and_drift_are_a_line_through_true_and_stamped_times():
    shots = _shots(offset_s=-0.7, drift_ppm=150.0, jitter_s=0.002, drop_fraction=0.1)
    slope, offset = np.polyfit(shots.t_ns / 1e9, shots.stamp_ns / 1e9, 1)
    assert slope - 1 == pytest.approx(150e-6, rel=1e-6)
    assert offset == pytest.approx(-0.7, abs=1e-8)


def test_a_fast_clock_takes_frames_sooner():
    shots = _shots(drift_ppm=5000.0)
    assert np.diff(shots.t_ns).mean() == pytest.approx(1e9 / 25 / 1.005, rel=1e-9)
    # in its own opinion it is exactly on time
    assert np.diff(shots.stamp_ns) == pytest.approx(1e9 / 25, abs=2)


def test_jitter_has_its_size_and_the_stamps_know_it():
    shots = _shots(jitter_s=0.003)
    off_s = shots.t_ns / 1e9 - (2.0 + shots.seq / 25.0)
    assert np.std(off_s[1:]) == pytest.approx(0.003, rel=0.1)
    np.testing.assert_allclose(shots.stamp_ns, shots.t_ns, atol=1)


def test_stamp_noise_is_what_the_stamps_do_not_know():
    shots = _shots(stamp_noise_s=0.002)
    assert np.std(shots.stamp_ns - shots.t_ns) == pytest.approx(2e6, rel=0.1)


def test_dropped_frames_leave_gaps_in_the_numbers():
    shots = _shots(drop_fraction=0.2)
    assert len(shots) == pytest.approx(800, abs=50)
    np.testing.assert_array_equal(shots.t_ns, np.round((2.0 + shots.seq / 25.0) * 1e9))
    assert (np.diff(shots.seq) > 1).any()


def test_wild_jitter_keeps_the_order():
    assert (np.diff(_shots(jitter_s=0.5).t_ns) > 0).all()


def test_same_seed_same_shots_and_cameras_differ():
    faults = {"jitter_s": 0.002, "drop_fraction": 0.1}
    np.testing.assert_array_equal(_shots(**faults).t_ns, _shots(**faults).t_ns)
    assert not np.array_equal(_shots(**faults).seq, _shots(index=2, **faults).seq)
    assert not np.array_equal(_shots(**faults).seq, _shots(seed=4, **faults).seq)


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        ({"offset_s": -3.0}, r"camera left: its clock starts at -1.000 s.*set start_s to at least 3.000"),
        ({"phase_s": 50.0}, "camera left: no frame is left.*make duration_s longer"),
        ({"stamp_noise_s": 0.1}, "camera left: stamp_noise_s 0.1 puts frames out of order"),
    ],
)
def test_impossible_clocks_are_refused(sensor, message):
    refusal(ConfigError, message, _shots, **sensor)
