import numpy as np
import pytest
from built import of_white_jerk, poses

from posefuse.core import SE3, Kind
from posefuse.tracking import SmoothSettings, smooth
from posefuse.tracking.smoothing import _jerk_density

T_NS = np.round(np.arange(300) * 1e9 / 60).astype(np.int64)


@pytest.fixture
def walk():
    """Two people walking at irregular times, with gaps, an outlier and uneven noise."""
    rng = np.random.default_rng(0)
    t_ns = T_NS + rng.integers(-4_000_000, 4_000_000, 300)
    phase = 2 * np.pi * t_ns[:, None, None] * 1e-9 * rng.uniform(0.3, 1.5, (2, 17)) + rng.uniform(0, 6, (2, 17))
    body = rng.normal(size=(2, 17, 3)) * 0.4
    xyz = body + 0.1 * np.stack([np.sin(phase), np.cos(phase), np.sin(2 * phase)], axis=-1)
    roots = rng.normal(size=(300, 2, 17, 3, 3)) * 0.004 + np.eye(3) * 0.006
    xyz = xyz + (roots @ rng.normal(size=(*xyz.shape, 1)))[..., 0]
    xyz[rng.random(xyz.shape[:-1]) < 0.1] = np.nan
    xyz[100:115, 0, 4] = np.nan
    xyz[50, 1, 7] += 0.4
    return t_ns, xyz, roots @ np.swapaxes(roots, -1, -2)


@pytest.mark.parametrize("bones", [False, True])
def test_moving_the_world_moves_the_answer(walk, bones):
    t_ns, xyz, cov = walk
    move = SE3.from_rotvec([0.3, -1.1, 2.0], [5.0, -3.0, 0.7])
    turn = move.matrix()
    settings = SmoothSettings(bones=bones)
    here = smooth(poses(xyz, cov=cov, t_ns=t_ns), settings)
    there = smooth(poses(move @ xyz, cov=turn @ cov @ turn.T, t_ns=t_ns), settings)
    np.testing.assert_allclose(there.xyz_world, move @ here.xyz_world, atol=1e-7)
    np.testing.assert_allclose(there.cov_world, turn @ here.cov_world @ turn.T, atol=1e-8)
    np.testing.assert_array_equal(there.kind, here.kind)


@pytest.mark.parametrize("bones", [False, True])
def test_time_run_backwards_gives_the_same_path(walk, bones):
    """No lag in either direction."""
    t_ns, xyz, cov = walk
    settings = SmoothSettings(bones=bones)
    ahead = smooth(poses(xyz, cov=cov, t_ns=t_ns), settings)
    back = smooth(poses(xyz[::-1], cov=cov[::-1], t_ns=t_ns[-1] - t_ns[::-1]), settings)
    np.testing.assert_allclose(back.xyz_world[::-1], ahead.xyz_world, atol=1e-5)
    np.testing.assert_array_equal(back.kind[::-1], ahead.kind)


@pytest.mark.parametrize("cutoff", [3.0, 6.0, 12.0])
def test_the_response_at_the_cutoff_is_minus_3_db_without_lag(cutoff):
    settings = SmoothSettings(bones=False, cutoff_hz=cutoff, outlier_sigma=1e6)
    inside = slice(80, 220)
    for share, gain in ((0.3, 0.9997), (1.0, np.sqrt(0.5)), (1.5, 0.175)):
        xyz = np.zeros((300, 1, 17, 3))
        frequency = cutoff * share
        # whole periods inside the window
        frequency = max(1, round(frequency * 140 / 60)) * 60 / 140
        wave = np.exp(2j * np.pi * frequency * T_NS * 1e-9)
        xyz[..., 1] = wave.imag[:, None, None]
        out = smooth(poses(xyz, cov=np.eye(3) * 1e-4, t_ns=T_NS), settings).xyz_world[inside, 0, 0, 1]
        response = (out * wave[inside].conj()).mean() / (wave.imag[inside] * wave[inside].conj()).mean()
        expected = 1 / (1 + (frequency / cutoff) ** 6 * (np.sqrt(2) - 1))
        assert expected == pytest.approx(gain, abs=0.06)
        assert abs(response) == pytest.approx(expected, abs=0.005)
        assert np.angle(response) == pytest.approx(0, abs=0.01)


def test_covariance_matches_the_errors_on_motion_of_its_own_model():
    """NEES of 3 at measured time steps and inside gaps, uneven noise."""
    rng = np.random.default_rng(4)
    # so little that the jerk of 6 Hz leaves accelerations that a person can have: in gaps larger ones are held back
    noise = np.array([[4.0, 1.0, 0.5], [1.0, 9.0, 2.0], [0.5, 2.0, 3.0]]) * 1e-7
    dt, people = 1 / 60, 12
    truth = of_white_jerk(300, people, dt, _jerk_density(T_NS * 1e-9, noise[None], 6.0), rng)
    seen = truth + rng.normal(size=truth.shape) @ np.linalg.cholesky(noise).T
    for start in range(20, 280, 40):
        seen[start : start + 9] = np.nan
    result = smooth(poses(seen, cov=noise, t_ns=T_NS), SmoothSettings(bones=False, lasting_share=0.0))
    error = result.xyz_world - truth
    squared = np.einsum("tnki,tnkij,tnkj->tnk", error, np.linalg.inv(result.cov_world), error)
    assert squared[result.kind == Kind.SMOOTHED].mean() == pytest.approx(3.0, abs=0.2)
    assert squared[result.kind == Kind.INTERPOLATED].mean() == pytest.approx(3.0, abs=0.4)
