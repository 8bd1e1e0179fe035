"""Decoding heatmaps: recovery of a drawn spot, mirror images, doubt."""

import numpy as np
import pytest

from posefuse.detection.decode import landmarks_from_outputs

SIDE, CELLS, CHANNELS, COUNT = 256, 64, 39, 33


def outputs(xy_corner: np.ndarray, regressed_off: float = 0.0, width: float = 1.5, strength: float = 1.0):
    """Network outputs for spots at crop coordinates from the corner (B, COUNT, 2)."""
    batch = len(xy_corner)
    landmarks = np.zeros((batch, CHANNELS, 5), np.float32)
    landmarks[:, :COUNT, :2] = xy_corner + regressed_off
    landmarks[..., 3] = 2.0
    row, column = np.mgrid[0:CELLS, 0:CELLS]
    mass = np.zeros((batch, CELLS, CELLS, CHANNELS))
    for b in range(batch):
        for k in range(COUNT):
            x, y = xy_corner[b, k] / 4
            mass[b, :, :, k] = strength * np.exp(-((column - x) ** 2 + (row - y) ** 2) / (2 * width**2))
    mass = np.clip(mass, 1e-7, 1 - 1e-4)
    return landmarks.reshape(batch, -1), np.full((batch, 1), 0.9, np.float32), np.log(mass / (1 - mass)).astype(np.float32)


def spots(seed: int, batch: int = 2) -> np.ndarray:
    return np.random.default_rng(seed).uniform(40, 216, (batch, COUNT, 2))


def test_a_spot_is_found_to_a_fraction_of_a_cell():
    xy = spots(1)
    seen = landmarks_from_outputs(*outputs(xy, regressed_off=3.0), COUNT, SIDE)
    assert np.abs(seen.xy_crop - (xy - 0.5)).max() < 0.4
    assert np.allclose(seen.presence, 0.9) and seen.visibility == pytest.approx(1 / (1 + np.exp(-2.0)))


def test_a_faint_heatmap_leaves_the_regressed_point():
    xy = spots(2)
    seen = landmarks_from_outputs(*outputs(xy, regressed_off=5.0, strength=0.05), COUNT, SIDE)
    assert np.allclose(seen.xy_crop, xy + 5.0 - 0.5, atol=1e-4)


def test_a_wider_spot_has_a_larger_sigma():
    xy = spots(3)
    narrow, wide = (landmarks_from_outputs(*outputs(xy, width=w), COUNT, SIDE) for w in (1.0, 2.5))
    assert (wide.spread_px > 1.3 * narrow.spread_px).all()


def test_points_at_and_beyond_the_border_stay_finite():
    xy = spots(4)
    xy[0, 0], xy[0, 1], xy[1, 2] = (0, 0), (300, -40), (255, 128)
    seen = landmarks_from_outputs(*outputs(xy), COUNT, SIDE)
    assert np.isfinite(seen.xy_crop).all() and np.isfinite(seen.spread_px).all()
    assert np.allclose(seen.xy_crop[0, 1], xy[0, 1] - 0.5, atol=1e-3)
