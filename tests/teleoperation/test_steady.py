"""The filter of a resting hand: what it must not do to a moving one."""

from dataclasses import replace

import numpy as np
import pytest

from bench.rehearsal.figures import jitter_m, lag_and_rms, rms_jerk, spectral_arc_length
from bench.rehearsal.person import person_view, sine
from posefuse_teleop.mapping import steadied

RATE_HZ, T0 = 100.0, 10**12
TURN = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


def lasting_noise(seed, count, rms_m):
    """Errors of a network: they last for some frames."""
    rng, now, found = np.random.default_rng(seed), np.zeros(3), []
    for _ in range(count):
        now = 0.9 * now + np.sqrt((1 - 0.9**2) / 3) * rms_m * rng.normal(size=3)
        found.append(now)
    return np.array(found)


def filtered(xyz, sigma_m, noise_m=0.005, period_ns=10_000_000):
    state, found = None, []
    for i, one in enumerate(xyz):
        state = steadied(state, person_view(one, T0 + i * period_ns, sigma_m=sigma_m), noise_m)
        found.append(state.xyz_world[0])
    return np.array(found)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_resting_hand_is_steady(seed):
    noise = lasting_noise(seed, 1000, 0.005)
    raw, after = jitter_m(noise, RATE_HZ), jitter_m(filtered(noise, 0.005 / np.sqrt(3)), RATE_HZ)
    assert raw > 0.004 and after < 0.002
    # it is the filter that does it
    assert jitter_m(filtered(noise, 0.005 / np.sqrt(3), noise_m=0.0), RATE_HZ) == pytest.approx(raw)


@pytest.mark.parametrize("speed_mps", [0.3, 0.5])
def test_a_moving_hand_is_not_late(speed_mps):
    path = sine(speed_mps)
    true = np.array([path(i / RATE_HZ) for i in range(1200)])
    noisy = true + lasting_noise(4, len(true), 0.005)
    lag_s, rms_m = lag_and_rms(true[200:], filtered(noisy, 0.005 / np.sqrt(3))[200:], RATE_HZ)
    _, rms_noisy_m = lag_and_rms(true[200:], noisy[200:], RATE_HZ)
    assert lag_s == 0.0 and rms_m < 1.1 * rms_noisy_m


def test_a_hand_known_exactly_passes_unchanged():
    path = sine(0.1)
    xyz = np.array([path(i / RATE_HZ) for i in range(300)])
    np.testing.assert_array_equal(filtered(xyz, 0.0), xyz)
    noisy = xyz + lasting_noise(5, 300, 0.005)
    np.testing.assert_array_equal(filtered(noisy, 0.01, noise_m=0.0)[50], noisy[50])


def test_it_does_not_matter_where_the_world_begins_and_how_it_lies():
    xyz = lasting_noise(6, 300, 0.01) + np.array([sine(0.2)(i / RATE_HZ) for i in range(300)])
    there = xyz @ TURN.T + [3.0, -2.0, 1.0]
    np.testing.assert_allclose(filtered(there, 0.003), filtered(xyz, 0.003) @ TURN.T + [3.0, -2.0, 1.0], atol=1e-12)


def test_another_person_and_a_pause_start_again():
    state = None
    for i in range(50):
        state = steadied(state, person_view(np.zeros(3), T0 + i * 10_000_000, sigma_m=0.01), 0.005)
    near = person_view(np.full(3, 0.003), T0 + 500_000_000, sigma_m=0.01)
    assert 0 < steadied(state, near, 0.005).xyz_world[0, 0] < 0.001
    for other in (replace(near, person_id=2), replace(near, t_ns=T0 + 2_000_000_000), replace(near, t_ns=T0)):
        np.testing.assert_array_equal(steadied(state, other, 0.005).xyz_world, other.xyz_world)
    lost = replace(near, xyz_world=np.full((1, 3), np.nan))
    missing = steadied(state, lost, 0.005)
    np.testing.assert_array_equal(steadied(missing, near, 0.005).xyz_world, near.xyz_world)


# --- figures of following against paths whose figures are known


T_S = np.arange(0, 10, 1 / RATE_HZ)


def two_waves(t_s):
    return np.stack([0.2 * np.sin(1.5 * t_s), 0.1 * np.cos(2.2 * t_s), 0.05 * t_s / 10], axis=1)


@pytest.mark.parametrize("lag_s", [0.0, 0.07, 0.2])
def test_a_delay_is_found_and_leaves_no_error(lag_s):
    lag, rms = lag_and_rms(two_waves(T_S), two_waves(T_S - lag_s) + [3.0, 1.0, 0.0], RATE_HZ)
    assert lag == pytest.approx(lag_s) and rms < 1e-4


def test_noise_is_found_as_error_and_as_jitter():
    noise = 0.003 * np.random.default_rng(0).normal(size=(len(T_S), 3))
    assert lag_and_rms(two_waves(T_S), two_waves(T_S) + noise, RATE_HZ)[1] == pytest.approx(0.003 * np.sqrt(3), rel=0.05)
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
