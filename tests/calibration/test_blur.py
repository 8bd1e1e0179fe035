"""Blur is measured on what moves, in every direction, and named where a calibration fails."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from calibrating import marker_page

from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.extrinsics.self_checks import check_sharp
from posefuse.calibration.extrinsics.target import calibrate_extrinsics
from posefuse.calibration.report import RefusedCalibration
from posefuse.calibration.targets.corners import joined
from posefuse.calibration.targets.detection import BLURRED_EDGE_PX, MovingEdges, edge_width_px, usual_edge_width_px

ANGLES_DEG = (0, 30, 45, 90, 120)


def picture(place_px: float = 0.0, blur: np.ndarray | None = None) -> np.ndarray:
    """A marker, at another place in each image, before a sharp background that stays."""
    background = np.where(np.indices((240, 320)).sum(axis=0) // 20 % 2, 90, 140).astype(np.uint8)
    there = slice(45, 165), slice(30 + round(place_px), 190 + round(place_px))
    covered, drawn = np.zeros((2, *background.shape), np.float32)
    covered[there], drawn[there] = 1.0, marker_page()[..., 0]
    if blur is not None:
        covered, drawn = (cv2.filter2D(layer, -1, blur) for layer in (covered, drawn))
    image = (background * (1 - covered) + drawn).astype(np.uint8)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.6))


def motion(length_px: int, angle_deg: float) -> np.ndarray:
    """Kernel of a motion along one direction."""
    kernel = np.zeros((41, 41), np.float32)
    along = length_px / 2 * np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])
    ends = [tuple(int(v) for v in np.round(20 + sign * along)) for sign in (-1, 1)]
    cv2.line(kernel, *ends, 1.0)
    return np.asarray(kernel / kernel.sum())


def moving(blur: np.ndarray | None) -> list[np.ndarray]:
    return [picture(25 * i, blur) for i in range(5)]


def test_sharp_images_stay_below_the_limit() -> None:
    assert usual_edge_width_px(moving(None)) < 0.9 * BLURRED_EDGE_PX


@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_motion_in_any_direction_is_found_before_a_sharp_background(angle_deg: float) -> None:
    assert usual_edge_width_px(moving(motion(24, angle_deg))) > 1.2 * BLURRED_EDGE_PX
    # the background alone would hide it
    assert edge_width_px(picture()) < BLURRED_EDGE_PX


def test_width_grows_with_the_blur() -> None:
    widths = [usual_edge_width_px(moving(motion(length, 30))) for length in (1, 6, 12, 24)]
    assert np.all(np.diff(widths) > 0.5)


def test_where_nothing_moves_nothing_is_measured() -> None:
    still = MovingEdges(every=1)
    for _ in range(4):
        still.add(picture())
    assert np.isnan(still.width_px)


def test_a_calibration_that_fails_names_blurred_images(lab: Any) -> None:
    few = lab.watch()
    few = few.rows(few.t_ns < 10)
    widths = {"cam00": 12.0, "cam01": float("nan"), "cam02": 3.0, "cam03": 9.0}
    seen = replace(few, edge_width_px=tuple(widths.items()))
    with pytest.raises(RefusedCalibration, match=r"the images of cam00, cam03 are blurred.*exposure time, add light"):
        calibrate_extrinsics(seen, lab.rig.cameras, lab.target, Options(clocks="together"))
    # sharp images are not accused
    assert check_sharp(replace(few, edge_width_px=(("cam00", 3.0),))).passed
    assert joined([seen.of_camera(name) for name in widths]).edge_width_px[3] == ("cam03", 9.0)
