"""The depth that simulated cameras measure: in the right place, with the noise that they state."""

from dataclasses import replace

import numpy as np
import pytest

from posefuse.core.depth import MM_PER_M
from posefuse_sim.cameras import DepthSettings
from posefuse_sim.render.shot import measured_depth, noise_of

EXACT = DepthSettings(disparity_sigma_px=0, step_px=0, floor_m=0, lateral_px=0, edge_loss=0)


@pytest.mark.parametrize("depth_m", [1.0, 2.5, 4.0])
def test_noise_is_as_large_as_stated_and_alike_within_a_block(depth_m: float) -> None:
    settings = DepthSettings(lateral_px=0.0)
    image = measured_depth(np.full((240, 320), depth_m, np.float32), settings, [1])
    error_m = image.values / MM_PER_M - depth_m
    noise = noise_of(settings)
    # a step of the disparity adds the spread of one step
    step_m = depth_m**2 / (noise.focal_px * noise.baseline_m) * noise.step_px
    stated = np.hypot(float(noise.sigma_m(np.array(depth_m))), step_m / np.sqrt(12))
    assert error_m.std() == pytest.approx(stated, rel=0.05)
    assert abs(error_m.mean()) < 0.1 * stated
    if depth_m > 2:
        beside = np.corrcoef(error_m[:, :-1].ravel(), error_m[:, 1:].ravel())[0, 1]
        apart = np.corrcoef(error_m[:, :-20].ravel(), error_m[:, 20:].ravel())[0, 1]
        assert beside > 0.7
        assert abs(apart) < 0.1


def test_a_disparity_has_steps() -> None:
    settings = replace(EXACT, step_px=1 / 8)
    ramp = np.tile(np.linspace(3, 4, 320, dtype=np.float32), (4, 1))
    values = measured_depth(ramp, settings, [1]).values
    disparity = settings.focal_px * settings.baseline_m / (values / MM_PER_M)
    assert np.abs(disparity * 8 - np.rint(disparity * 8)).max() < 0.03
    assert len(np.unique(values)) < 20


def test_edges_lose_pixels_and_are_ragged_and_the_far_is_unknown() -> None:
    true_m = np.full((200, 200), 3.0, np.float32)
    true_m[:, :100] = 1.5
    true_m[:20] = 30.0
    plain = measured_depth(true_m, EXACT, [1]).values
    np.testing.assert_array_equal(plain[20:], np.where(true_m[20:] == 1.5, 1500, 3000))
    assert (plain[:20] == 0).all()
    torn = measured_depth(true_m, replace(EXACT, lateral_px=0.8, edge_loss=0.5), [1]).values[40:]
    assert 0.3 < (torn[:, 98:102] == 0).mean() < 0.7
    assert (torn[:, 110:] == 3000).all()
    column = torn[:, 99]
    assert 0.05 < (column[column > 0] == 3000).mean() < 0.5
