"""Figures of following against paths whose figures are known."""

import numpy as np
import pytest

from bench.rehearsal.figures import jitter_m, lag_and_rms, rms_jerk, spectral_arc_length

RATE_HZ = 100.0
T_S = np.arange(0, 10, 1 / RATE_HZ)


def path(t_s):
    return np.stack([0.2 * np.sin(1.5 * t_s), 0.1 * np.cos(2.2 * t_s), 0.05 * t_s / 10], axis=1)


@pytest.mark.parametrize("lag_s", [0.0, 0.07, 0.2])
def test_a_delay_is_found_and_leaves_no_error(lag_s):
    lag, rms = lag_and_rms(path(T_S), path(T_S - lag_s) + [3.0, 1.0, 0.0], RATE_HZ)
    assert lag == pytest.approx(lag_s) and rms < 1e-4


def test_noise_is_found_as_error_and_as_jitter():
    noise = 0.003 * np.random.default_rng(0).normal(size=(len(T_S), 3))
    assert lag_and_rms(path(T_S), path(T_S) + noise, RATE_HZ)[1] == pytest.approx(0.003 * np.sqrt(3), rel=0.05)
    assert jitter_m(noise, RATE_HZ) == pytest.approx(0.003 * np.sqrt(3), rel=0.05)


def test_smoothness_ranks_paths_and_does_not_depend_on_their_size():
    x = np.clip(T_S / 2 - 1, 0, 1)
    reach = np.zeros((len(T_S), 3))
    reach[:, 0] = x**3 * (10 - 15 * x + 6 * x**2)
    shaky = reach + 0.002 * np.sin(2 * np.pi * 6 * T_S)[:, None]
    assert spectral_arc_length(reach, RATE_HZ) > spectral_arc_length(shaky, RATE_HZ)
    assert spectral_arc_length(7 * reach, RATE_HZ) == pytest.approx(spectral_arc_length(reach, RATE_HZ))
    # of a minimum-jerk movement in the literature: about -1.4
    assert spectral_arc_length(reach, RATE_HZ) == pytest.approx(-1.41, abs=0.05)


def test_jerk_of_a_sine():
    xyz = np.stack([0.2 * np.sin(3 * T_S), 0 * T_S, 0 * T_S], axis=1)
    assert rms_jerk(xyz, RATE_HZ) == pytest.approx(0.2 * 27 / np.sqrt(2), rel=0.02)
