"""Clocks: what a camera exposes when, and what it writes on it."""

import numpy as np
import pytest

from posefuse.core import ConfigError
from posefuse_sim.cameras import SensorSettings, shots_of


def _shots(seed=3, index=1, rate_hz=25.0, start_s=2.0, duration_s=40.0, **sensor):
    return shots_of("left", index, SensorSettings(**sensor), rate_hz=rate_hz, start_s=start_s, duration_s=duration_s, seed=seed)


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
    with pytest.raises(ConfigError, match=message):
        _shots(**sensor)
