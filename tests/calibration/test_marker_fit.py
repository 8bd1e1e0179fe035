"""Corners of drawn markers: blurred, noisy, with a camera's tone curve, or not there at all."""

import cv2
import numpy as np
import pytest

from posefuse.calibration.targets.marker_fit import fit_marker

DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
BLACK = (DICTIONARY.generateImageMarker(3, 6) < 128).astype(float)
FINER = 8


def drawn(
    quad: np.ndarray, size_wh: tuple[int, int], blur_px: float = 0.8, gamma: float = 1.0, seed: int = 0, finer: int = FINER
) -> np.ndarray:
    """Grey image of a marker with a white border of one module on a dark wall; pixel centres at integers."""
    square = np.array([[0, 0], [6, 0], [6, 6], [0, 6]], np.float32)
    marker_from_px = np.linalg.inv(cv2.getPerspectiveTransform(square, quad.astype(np.float32)))
    x, y = np.meshgrid(*((np.arange(n * finer) + 0.5) / finer - 0.5 for n in size_wh))
    place = np.stack([x, y, np.ones_like(x)], axis=-1) @ marker_from_px.T
    u, v = np.moveaxis(np.floor(place[..., :2] / place[..., 2:]).astype(int), -1, 0)
    light = np.where((u >= -1) & (u <= 6) & (v >= -1) & (v <= 6), 1.0, 0.3)
    inside = (u >= 0) & (u < 6) & (v >= 0) & (v < 6)
    light[inside] = 1 - 0.95 * BLACK[v[inside], u[inside]]
    light = cv2.GaussianBlur(light, (0, 0), blur_px * finer)
    light = light.reshape(size_wh[1], finer, size_wh[0], finer).mean(axis=(1, 3))
    grey = 230 * light ** (1 / gamma) + np.random.default_rng(seed).normal(0, 2, light.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def quad_of(side_px: float, seed: int) -> np.ndarray:
    shape = np.array([[0, 0], [1, 0.1], [1.08, 0.95], [-0.05, 1]])
    return shape * side_px + 0.25 * side_px + np.random.default_rng(seed).uniform(0, 1, 2)


def area(quad: np.ndarray) -> float:
    return abs(float(cv2.contourArea(quad.astype(np.float32))))


@pytest.mark.parametrize(("gamma", "most_growth"), [(1.0, 0.0006), (2.2, 0.004)])
def test_markers_come_out_where_they_are_and_as_large_as_they_are(gamma: float, most_growth: float) -> None:
    off, growth = [], []
    for seed, (side, blur) in enumerate((s, b) for s in (28, 45, 90) for b in (0.6, 1.0)):
        quad = quad_of(side, seed)
        grey = drawn(quad, (int(1.6 * side), int(1.6 * side)), blur, gamma, seed)
        rough = quad + np.random.default_rng(seed).uniform(-0.7, 0.7, (4, 2))
        found = fit_marker(grey, rough, BLACK)
        off.append(np.abs(found - quad).max())
        growth.append(np.sqrt(area(found) / area(quad)) - 1)
    assert max(off) < (0.12 if gamma == 1 else 0.35)
    # half a px of edge would be several per cent of the room
    assert abs(float(np.mean(growth))) < most_growth


@pytest.mark.parametrize("side", [300, 600])
def test_every_edge_of_a_large_sharp_marker_counts(side: int) -> None:
    # edges along the pixel rows: every n-th pixel may miss them, by up to its step
    quad = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]) * side + 0.25 * side + [0.37, 0.81]
    found = fit_marker(drawn(quad, (int(1.5 * side),) * 2, 0.4, finer=3), quad + 0.6, BLACK)
    assert np.abs(found - quad).max() < 0.2
    assert abs(float(np.sqrt(area(found) / area(quad))) - 1) < 2e-4


def test_a_finger_over_a_corner_moves_the_others_little() -> None:
    quad = quad_of(60, 1)
    grey = drawn(quad, (96, 96))
    grey[int(quad[2, 1]) - 12 :, int(quad[2, 0]) - 12 :] = 150
    found = fit_marker(grey, quad + 0.5, BLACK)
    assert np.abs(found - quad).max() < 0.3


def test_what_is_not_that_marker_is_left_out() -> None:
    quad = quad_of(40, 2)
    grey = drawn(quad, (64, 64))
    assert fit_marker(grey, quad, BLACK) is not None
    assert fit_marker(grey, quad, np.rot90(BLACK)) is None
    assert fit_marker(np.full_like(grey, 90), quad, BLACK) is None
    assert fit_marker(grey, quad + 500.0, BLACK) is None
