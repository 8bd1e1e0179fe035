"""Corners of drawn markers and boards: blurred, noisy, with a camera's tone curve, or not there at all."""

import cv2
import numpy as np
import pytest

from posefuse.calibration.targets.detection import TargetDetector
from posefuse.calibration.targets.kinds import Charuco
from posefuse.calibration.targets.pattern_fit import fit_marker

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


def test_a_marker_seen_askew_keeps_its_size() -> None:
    # its blur is as wide along both diagonals, one of which is three times as long as the other
    longer = []
    for seed in range(6):
        turn, middle = 0.4 * seed, np.array([45.0, 45.0]) + np.random.default_rng(seed).uniform(0, 1, 2)
        long, short = 28 * np.array([np.cos(turn), np.sin(turn)]), 28 / 3 * np.array([-np.sin(turn), np.cos(turn)])
        quad = middle + [-long, -short, long, short]
        found = fit_marker(drawn(quad, (90, 90), seed=seed), quad + 0.2, BLACK)
        longer.append(np.linalg.norm(found[2] - found[0]) / 56 - 1)
    assert abs(float(np.mean(longer))) < 0.004


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


BOARD = Charuco(columns=6, rows=8, square_m=0.06, marker_m=0.045)


def drawn_board(square_px: float, tilt_deg: float, blur_px: float = 0.7, bend: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Grey image of the board on a dark wall, tilted about its diagonal, and where all of its corners are.

    What the lens shows in a corner of the image lies `bend` of its distance from the middle further out.
    """
    finer, size, middle = 4, np.array([640, 480]), np.array([319.5, 239.5])
    picture = cv2.copyMakeBorder(BOARD.board().generateImage((576, 768)), *[60] * 4, cv2.BORDER_CONSTANT, value=255)
    turn = cv2.Rodrigues(np.deg2rad(tilt_deg) * np.array([0.6, 0.8, 0.0]))[0]
    camera = np.array([[900.0, 0, 320.2], [0, 900.0, 239.6], [0, 0, 1]])
    px_from_squares = camera @ np.column_stack([turn[:, 0], turn[:, 1], [0, 0, 900 / square_px] - turn @ [3, 4, 0]])
    picture_from_squares = np.array([[96, 0, 59.5], [0, 96, 59.5], [0, 0, 1]])

    def straight(px: np.ndarray) -> np.ndarray:
        return middle + (px - middle) * (1 + bend * ((px - middle) ** 2).sum(axis=-1, keepdims=True) / (middle @ middle))

    columns, rows = np.meshgrid(*((np.arange(finer * one) - (finer - 1) / 2) / finer for one in size))
    picture_from_px = (picture_from_squares @ np.linalg.inv(px_from_squares)).astype(np.float32)
    places = cv2.perspectiveTransform(straight(np.stack([columns, rows], axis=-1)).astype(np.float32), picture_from_px)
    large = cv2.remap(picture, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=110)
    grey = cv2.GaussianBlur(cv2.resize(large, size.tolist(), interpolation=cv2.INTER_AREA).astype(float), (0, 0), blur_px)
    grey += np.random.default_rng(0).normal(0, 2, grey.shape)
    corners = BOARD.corners(0)[:, :2] / BOARD.square_m
    wanted = cv2.perspectiveTransform(np.column_stack([corners[:, 0], BOARD.rows - corners[:, 1]])[None], px_from_squares)[0]
    seen = wanted
    for _ in range(50):
        seen = seen + wanted - straight(seen)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8), seen


@pytest.mark.parametrize(
    ("square_px", "tilt_deg", "blur_px", "bend"),
    [(20, 20, 0.7, 0.0), (30, 50, 0.7, 0.0), (30, 20, 1.2, 0.0), (40, 60, 0.5, 0.0), (30, 20, 0.7, 0.3), (60, 45, 0.7, 0.3)],
)
def test_corners_of_a_board_are_right_to_hundredths_of_a_pixel(square_px, tilt_deg, blur_px, bend):
    """Of small and oblique squares, where OpenCV's are off by some tenths, and of large ones behind a wide lens."""
    grey, true = drawn_board(square_px, tilt_deg, blur_px, bend)
    read, ids, _, _ = cv2.aruco.CharucoDetector(BOARD.board()).detectBoard(grey)
    off_opencv = np.linalg.norm(read.reshape(-1, 2) - true[ids.ravel()], axis=1)
    found = TargetDetector(BOARD).detect(grey)
    off = np.linalg.norm(found.xy_img - true[found.corner], axis=1)
    assert len(off) >= 0.9 * len(off_opencv) >= 18
    assert np.sqrt((off**2).mean()) < min(0.04, 0.6 * np.sqrt((off_opencv**2).mean()))


def test_corners_behind_a_hand_are_left_out():
    grey, true = drawn_board(30, 20)
    covered = np.array(grey)
    hand = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 255, (480, 640)).astype(np.uint8), (0, 0), 9)
    left = int(true[:, 0].mean())
    covered[:, left:] = hand[:, left:]
    found = TargetDetector(BOARD).detect(covered)
    assert len(found.corner) and (true[found.corner, 0] < left).all()
    assert np.linalg.norm(found.xy_img - true[found.corner], axis=1).max() < 0.1
