"""Depth sampled at keypoints: the surface of the body, not what lies behind a thin limb, with an honest sigma."""

from dataclasses import replace

import numpy as np
import pytest
from built import detections, frame
from checks import refusal

from posefuse.core import Detections2D, ShapeError
from posefuse.core.depth import DepthImage, DepthNoise
from posefuse.core.skeleton import COCO17
from posefuse.detection import with_depth

WRIST, HIP = COCO17.index("left_wrist"), COCO17.index("left_hip")


def person(xy: np.ndarray, score: float = 0.9) -> Detections2D:
    return detections("c", np.asarray(xy, float)[None], score=score)


def keypoints() -> np.ndarray:
    """17 places over a body of 200 px."""
    return np.stack([np.linspace(90, 150, 17), np.linspace(20, 220, 17)], axis=1)


def around(at: np.ndarray) -> tuple[slice, slice]:
    """The pixels about a place."""
    x, y = np.rint(at).astype(int)
    return slice(y - 10, y + 11), slice(x - 10, x + 11)


def test_a_flat_body_has_its_depth_and_the_noise_of_the_camera() -> None:
    noise = DepthNoise(focal_px=400, baseline_m=0.1, disparity_sigma_px=0.1)
    depth = DepthImage(values=np.full((240, 240), 2500, np.uint16), noise=noise)
    found = with_depth(person(keypoints()), depth).depth_m
    np.testing.assert_allclose(found[0, :, 0], 2.5)
    np.testing.assert_allclose(found[0, :, 1], float(noise.sigma_m(np.array(2.5))), rtol=1e-5)
    # the same depth in other units
    metric = DepthImage(values=np.full((240, 240), 25000, np.uint16), unit_m=1e-4, noise=noise)
    other = with_depth(person(keypoints()), metric).depth_m
    np.testing.assert_allclose(other, found, rtol=1e-6)


def test_the_wall_next_to_a_thin_limb_does_not_count() -> None:
    xy = keypoints()
    values = np.full((240, 240), 4000, np.uint16)
    values[:, 60:200] = 2500
    # the wrist is a strip of 2 px before the far wall
    values[around(xy[WRIST])] = 4000
    values[around(xy[WRIST])][:, 9:11] = 2300
    found = with_depth(person(xy), DepthImage(values=values)).depth_m
    assert found[0, WRIST, 0] == pytest.approx(2.3)
    assert found[0, HIP, 0] == pytest.approx(2.5)


def test_holes_walls_and_edges_of_the_image_have_no_depth() -> None:
    xy = keypoints()
    values = np.full((240, 240), 2500, np.uint16)
    values[around(xy[HIP])] = 0
    values[around(xy[WRIST])] = 5000
    xy[0] = [-50, 30]
    xy[1] = np.nan
    found = with_depth(person(xy), DepthImage(values=values)).depth_m
    assert np.isnan(found[0, [HIP, WRIST, 0, 1]]).all()
    assert np.isfinite(np.delete(found[0], [HIP, WRIST, 0, 1], axis=0)).all()


def test_no_depth_image_no_depth_and_no_person_no_row() -> None:
    assert with_depth(person(keypoints()), None).depth_m is None
    depth = DepthImage(values=np.zeros((240, 240), np.uint16))
    assert np.isnan(with_depth(person(keypoints()), depth).depth_m).all()
    assert with_depth(Detections2D.empty("c", 0, COCO17), depth).depth_m.shape == (0, 17, 2)


def test_a_keypoint_that_may_be_hidden_has_no_depth() -> None:
    seen = person(keypoints())
    score = seen.score.copy()
    score[0, WRIST] = 0.3
    found = with_depth(replace(seen, score=score), DepthImage(values=np.full((240, 240), 2500, np.uint16))).depth_m
    assert np.isnan(found[0, WRIST]).all()
    assert np.isfinite(np.delete(found[0], WRIST, axis=0)).all()


def test_a_depth_image_of_another_size_or_type_is_refused() -> None:
    refusal(ShapeError, "uint16", DepthImage, values=np.zeros((4, 4), np.float32))
    refusal(ShapeError, "depth of the image's size", frame, depth=DepthImage(values=np.zeros((4, 4), np.uint16)))
