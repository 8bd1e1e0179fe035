"""Regions follow the person: equivariance, agreement with the camera, crops that show what the map says."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from posefuse.core import SE3, SKELETONS, Region
from posefuse.detection import region_from_keypoints, region_from_pose, up_angle_rad
from posefuse.detection.crops import crop_from_img, img_from_crop, square_crop

BODY = SKELETONS["blazepose33"]


def person_px(rng: np.random.Generator) -> np.ndarray:
    """Keypoints of a person roughly upright, 300 px tall."""
    xy = rng.uniform([-60, -150], [60, 150], (len(BODY), 2))
    names = ("left_hip", "right_hip", "left_shoulder", "right_shoulder")
    xy[BODY.indices(names)] = [(20, 0), (-20, 3), (28, -90), (-25, -88)]
    return xy + [400, 300]


@pytest.mark.parametrize("turn_rad", [0.4, -1.3, 3.0])
def test_a_region_turns_moves_and_grows_with_the_person(turn_rad):
    xy = person_px(np.random.default_rng(3))
    before = region_from_keypoints(xy, BODY)
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.array([[cosine, -sine], [sine, cosine]])  # clockwise on screen, y down
    after = region_from_keypoints(1.7 * xy @ turn.T + [30, -20], BODY)
    assert np.allclose(after.centre_img, 1.7 * turn @ before.centre_img + [30, -20])
    assert after.side_px == pytest.approx(1.7 * before.side_px)
    off = after.angle_rad - before.angle_rad - turn_rad
    assert abs(np.arctan2(np.sin(off), np.cos(off))) < 1e-9


def test_every_keypoint_lies_well_inside_the_crop_and_the_spine_stands_upright():
    xy = person_px(np.random.default_rng(4))
    region = region_from_keypoints(xy, BODY)
    affine = crop_from_img(region, 256)
    seen = xy @ affine[:, :2].T + affine[:, 2]
    assert seen.min() > 5 and seen.max() < 250
    hips, shoulders = (seen[BODY.indices([f"left_{n}", f"right_{n}"])].mean(0) for n in ("hip", "shoulder"))
    assert np.allclose(hips, 127.5)
    assert shoulders[0] == pytest.approx(127.5) and shoulders[1] < hips[1]


def test_missing_keypoints_are_left_out_and_too_few_give_no_region():
    xy = person_px(np.random.default_rng(5))
    partly = xy.copy()
    partly[:11] = np.nan
    assert np.allclose(region_from_keypoints(partly, BODY).centre_img, region_from_keypoints(xy, BODY).centre_img)
    partly[3:] = np.nan
    assert region_from_keypoints(partly, BODY) is None


@pytest.mark.parametrize("roll_rad", [0.0, 0.5, -2.0])
def test_without_a_spine_up_is_gravity(ring_rig, roll_rad):
    camera = ring_rig(3).cameras[1]
    rolled = replace(camera, cam_from_world=SE3.from_rotvec([0, 0, roll_rad], [0, 0, 0]) @ camera.cam_from_world)
    rng = np.random.default_rng(6)
    xyz = rng.uniform([-0.3, -0.3, 0.1], [0.3, 0.3, 1.7], (len(BODY), 3))
    xyz[BODY.indices(["left_shoulder", "right_shoulder"])] = np.nan
    assert region_from_pose(rolled, xyz, BODY).angle_rad == pytest.approx(roll_rad, abs=0.05)
    assert up_angle_rad(rolled) == pytest.approx(roll_rad, abs=1e-9)


def test_a_pose_gives_the_region_of_its_projection(ring_rig):
    camera = ring_rig(5, distortion=(0.05, -0.02, 0.001, 0.0)).cameras[3]
    xyz = np.random.default_rng(7).uniform([-0.3, -0.3, 0.1], [0.3, 0.3, 1.7], (len(BODY), 3))
    got, expected = region_from_pose(camera, xyz, BODY), region_from_keypoints(camera.project(xyz), BODY)
    assert np.allclose(got.centre_img, expected.centre_img) and got.side_px == pytest.approx(expected.side_px)
    behind = xyz + 3 * (camera.centre_world - xyz.mean(0))
    assert region_from_pose(camera, behind, BODY) is None
    assert region_from_pose(camera, np.full_like(xyz, np.nan), BODY) is None


@pytest.mark.parametrize(("side_px", "angle_rad"), [(100.0, 0.0), (300.0, 0.7), (900.0, -2.1), (1500.0, 0.3)])
def test_a_crop_shows_a_spot_at_its_mapped_position(side_px, angle_rad):
    region = Region(centre_img=np.array([410.3, 395.8]), side_px=side_px, angle_rad=angle_rad)
    spot = region.centre_img + 0.2 * side_px * np.array([0.6, -0.8])
    y, x = np.mgrid[0:800, 0:900]
    width = max(2.0, side_px / 60)
    bright = 250 * np.exp(-((x - spot[0]) ** 2 + (y - spot[1]) ** 2) / (2 * width**2))
    crop = square_crop(np.repeat(bright[..., None], 3, axis=-1).astype(np.uint8), region, 256)[..., 0].astype(float)
    at_y, at_x = np.mgrid[0:256, 0:256]
    seen = np.array([(crop * at_x).sum(), (crop * at_y).sum()]) / crop.sum()
    assert np.allclose(img_from_crop(region, 256, seen), spot, atol=0.15 * max(1, side_px / 256))


def three_channels(image: np.ndarray, region: Region, side_px: int) -> np.ndarray:
    """What `square_crop` computes with four."""
    finer = int(np.clip(round(region.side_px / side_px / 2), 1, 3))
    sampled = cv2.warpAffine(image, crop_from_img(region, side_px * finer), (side_px * finer, side_px * finer))
    return sampled if finer == 1 else cv2.resize(sampled, (side_px, side_px), interpolation=cv2.INTER_AREA)


def test_crops_of_images_and_regions_of_any_size_are_those_of_three_channels_one_after_the_other():
    rng = np.random.default_rng(8)
    for i in range(60):
        size = (48, 64) if i % 2 else tuple(rng.integers(20, 200, 2))
        image = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
        side_px, angle_rad = float(np.exp(rng.uniform(2, 7))), float(rng.choice([0.0, np.pi / 2, rng.uniform(-4, 4)]))
        region = Region(centre_img=rng.uniform(-50, 250, 2), side_px=side_px, angle_rad=angle_rad)
        side = int(rng.choice([32, 64]))
        np.testing.assert_array_equal(square_crop(image, region, side), three_channels(image, region, side))
