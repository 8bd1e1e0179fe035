"""Colours of clothes: where they are read, in which numbers, and what is left unknown."""

import cv2
import numpy as np
import pytest
from built import detections

from posefuse.core import Detections2D
from posefuse.core.skeleton import BLAZEPOSE33, COCO17, HALPE_26
from posefuse.detection import with_clothing
from posefuse.detection.appearance import lab_from_srgb, median_colour

SHIRT, TROUSERS, WALL = (178, 38, 38), (26, 38, 89), (200, 200, 200)
# a person of 180 px in front of the camera: middle (x, y), half width
PLACES = {"shoulder": (60, 22), "hip": (110, 14), "knee": (155, 14), "ankle": (200, 14)}


def picture(shift: int = 0) -> np.ndarray:
    image = np.full((240, 320, 3), WALL, np.uint8)
    x = 100 + shift
    image[58:112, x - 24 : x + 25] = SHIRT
    for side in (-1, 1):
        image[112:204, x + side * 14 - 6 : x + side * 14 + 7] = TROUSERS
    return image


def person(skeleton=COCO17, shift: int = 0, score: float = 0.9) -> Detections2D:
    xy = np.full((1, len(skeleton), 2), np.nan)
    for i, name in enumerate(skeleton.keypoints):
        side, _, part = name.partition("_")
        if part in PLACES:
            y, half = PLACES[part]
            xy[0, i] = 100 + shift + (half if side == "left" else -half), y
    return detections("a", xy, score=score, skeleton=skeleton)


def test_lab_is_that_of_opencv() -> None:
    """OpenCV interpolates in tables: it is right to 0.3."""
    rgb = np.random.default_rng(0).integers(0, 256, (50, 1, 3)).astype(np.uint8)
    theirs = cv2.cvtColor((rgb / 255).astype(np.float32), cv2.COLOR_RGB2LAB)
    assert np.allclose(lab_from_srgb(rgb), theirs, atol=0.4)


@pytest.mark.parametrize("skeleton", [COCO17, BLAZEPOSE33, HALPE_26], ids=lambda s: s.name)
def test_trunk_and_legs_have_the_colours_of_shirt_and_trousers(skeleton) -> None:
    lab = with_clothing(person(skeleton), picture()).clothing_lab[0]
    assert np.allclose(lab, lab_from_srgb([SHIRT, TROUSERS, TROUSERS]), atol=1e-3)


def test_marks_that_are_a_little_off_change_nothing() -> None:
    rng = np.random.default_rng(1)
    seen = person()
    moved = Detections2D(**{**vars(seen), "xy_img": seen.xy_img + rng.normal(0, 2.0, seen.xy_img.shape)})
    assert np.allclose(with_clothing(moved, picture()).clothing_lab, with_clothing(seen, picture()).clothing_lab, atol=1e-3)


def test_what_is_not_seen_has_no_colour() -> None:
    assert np.isnan(with_clothing(person(score=0.1), picture()).clothing_lab).all()
    assert np.isnan(with_clothing(person(shift=1000), picture()).clothing_lab).all()
    cut = with_clothing(person(), picture()[:120]).clothing_lab[0]
    assert np.isfinite(cut[0]).all() and np.isnan(cut[1:]).all()
    assert with_clothing(Detections2D.empty("a", 0, COCO17), picture()).clothing_lab.shape == (0, 3, 3)


@pytest.mark.parametrize("count", [1, 2, 4, 7, 24])
def test_medians_are_those_of_numpy(count: int) -> None:
    rgb = np.random.default_rng(count).integers(0, 256, (count, 3), np.uint8)
    np.testing.assert_array_equal(median_colour(rgb), np.median(rgb, axis=0))
