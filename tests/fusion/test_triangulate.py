"""Points out of views: exact through every lens, weighted as the paper weights, and not pulled by what is wrong."""

import re
from dataclasses import replace

import numpy as np
import pytest
from built import standing, turned
from checks import refusal

from posefuse.core import SE3, SKELETONS, ConfigError, Rig, ShapeError
from posefuse.fusion import WEIGHTS, FuseSettings, triangulate
from posefuse.fusion.kernels.robust import middle_residual
from posefuse.fusion.triangulation import SEGMENT_OF, SEGMENTS, distance_weight, full_weight, side_view

COCO, STANDING = SKELETONS["coco17"], standing()
LENSES = {
    0: (),
    4: (-0.2, 0.05, 0.001, -0.002),
    5: (-0.2, 0.05, 0.001, -0.002, 0.01),
    8: (-0.2, 0.05, 0.001, -0.002, 0.01, 0.02, -0.01, 0.005),
    12: (-0.2, 0.05, 0.001, -0.002, 0.01, 0.02, -0.01, 0.005, 0.001, -0.002, 0.003, -0.001),
    14: (-0.2, 0.05, 0.001, -0.002, 0.01, 0.02, -0.01, 0.005, 0.001, -0.002, 0.003, -0.001, 0.02, -0.03),
}


def cloud(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(*shape, 3)) * 0.4 + [0, 0, 1]


def pixels(rig: Rig, xyz: np.ndarray, sigma_px: float = 0.0, seed: int = 1) -> np.ndarray:
    """(..., C, K, 2) of (..., K, 3)."""
    xy = np.moveaxis(rig.project(xyz), 0, -3)
    return xy + sigma_px * np.random.default_rng(seed).normal(size=xy.shape)


@pytest.mark.parametrize("weights", ["none", "score", "robust"])
@pytest.mark.parametrize("coefficients", LENSES)
def test_clean_pixels_give_back_the_points_through_every_lens(ring_rig, weights, coefficients):
    rig = ring_rig(5, distortion=LENSES[coefficients])
    xyz = cloud(0, 2, 7)
    found, cov, reproj = triangulate(rig, pixels(rig, xyz), weights=weights)
    np.testing.assert_allclose(found, xyz, atol=1e-9)
    assert (reproj < 1e-6).all()
    assert (np.linalg.eigvalsh(cov) > 0).all()


def test_leading_axes_pass_through(ring_rig):
    rig = ring_rig(4)
    xyz = cloud(0, 3, 2, 5)
    xy = pixels(rig, xyz, 1.0)
    sigma = np.full(xy.shape[:-1], 1.0)
    whole = triangulate(rig, xy, sigma_px=sigma)
    assert whole.xyz.shape == (3, 2, 5, 3)
    assert whole.cov.shape == (3, 2, 5, 3, 3)
    assert whole.reproj.shape == whole.n_views.shape == (3, 2, 5)
    for i in range(3):
        for j in range(2):
            np.testing.assert_array_equal(triangulate(rig, xy[i, j], sigma_px=sigma[i, j]).xyz, whole.xyz[i, j])


def literal_wls(rig: Rig, xy: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """METHOD section 2 written out for one keypoint: rows (u m3 - m1), (v m3 - m2) in undistorted px."""
    rows, targets, weights = [], [], []
    for camera, seen, w in zip(rig, xy, weight, strict=True):
        m1, m2, m3 = camera.projection()
        u, v = camera.undistort(seen)
        rows += [(u * m3 - m1)[:3], (v * m3 - m2)[:3]]
        targets += [m1[3] - u * m3[3], m2[3] - v * m3[3]]
        weights += [w, w]
    a, b, w = np.array(rows), np.array(targets), np.diag(weights)
    return np.linalg.solve(a.T @ w @ a, a.T @ w @ b)


@pytest.mark.parametrize("weights", ["none", "score"])
def test_paper_weights_are_the_weighted_least_squares_of_the_algebraic_rows(ring_rig, weights):
    rig = ring_rig(6, distortion=LENSES[5])
    xyz = cloud(0, 4)
    xy = pixels(rig, xyz, 8.0)
    score = np.random.default_rng(5).uniform(0.2, 1.0, xy.shape[:-1])
    found = triangulate(rig, xy, score, weights=weights).xyz
    weight = np.ones_like(score) if weights == "none" else np.where(score < 0.4, 0.0, score**2)
    assert (weight == 0).any() == (weights == "score")
    for k in range(4):
        np.testing.assert_allclose(found[k], literal_wls(rig, xy[:, k], weight[:, k]), atol=1e-9)


def test_the_weights_of_the_settings_count_unless_others_are_named(ring_rig):
    rig, xyz = ring_rig(4), cloud(0, 4)
    xy = pixels(rig, xyz, 8.0)
    score = np.random.default_rng(5).uniform(0.2, 1.0, xy.shape[:-1])
    by_score = triangulate(rig, xy, score, weights="score").xyz
    np.testing.assert_array_equal(triangulate(rig, xy, score, settings=FuseSettings(weights="score")).xyz, by_score)
    named = triangulate(rig, xy, score, weights="score", settings=FuseSettings(weights="none")).xyz
    np.testing.assert_array_equal(named, by_score)
    assert not np.array_equal(triangulate(rig, xy, score).xyz, by_score)


def test_all_weighs_distance_and_side_view_of_the_first_pass(ring_rig):
    rig = ring_rig(5, radius_m=3.0)
    rig = Rig((*rig.cameras[:4], ring_rig(5, radius_m=10.0).cameras[4]))
    skeleton = COCO
    xy = pixels(rig, STANDING, 6.0)
    score = np.random.default_rng(5).uniform(0.5, 1.0, xy.shape[:-1])
    settings = FuseSettings(distance_min_m=2.0, distance_max_m=5.0, distance_fall_m=10.0)
    found = triangulate(rig, xy, score, weights="all", skeleton=skeleton, settings=settings).xyz

    first = triangulate(rig, xy, score, weights="score").xyz
    wrist, elbow = (first[skeleton.index(k)] for k in ("left_wrist", "left_elbow"))
    z_axis = (elbow - wrist) / np.linalg.norm(elbow - wrist)
    weight = []
    for camera, s in zip(rig, score[:, skeleton.index("left_wrist")], strict=True):
        away = np.linalg.norm(camera.centre_world - wrist)
        w_d = 1.0 if 2 <= away <= 5 else 1 - (away - 5) / 10
        w_o = 1 - abs(camera.cam_from_world.matrix()[2] @ z_axis)
        weight.append(s**2 * (w_o + w_d) / 2)
    expected = literal_wls(rig, xy[:, skeleton.index("left_wrist")], np.array(weight))
    np.testing.assert_allclose(found[skeleton.index("left_wrist")], expected, atol=1e-9)


@pytest.mark.parametrize(("count", "bad"), [(4, 1), (8, 2), (16, 4), (24, 8)])
def test_robust_is_not_pulled_by_wrong_views(ring_rig, count, bad):
    rig = ring_rig(count, distortion=LENSES[5])
    xyz = cloud(0, 40, 9)
    xy = pixels(rig, xyz, 1.0)
    sigma = np.ones(xy.shape[:-1])
    best = np.linalg.norm(triangulate(rig, xy, sigma_px=sigma).xyz - xyz, axis=-1)
    rng = np.random.default_rng(3)
    for g in range(40):
        for k in range(9):
            wrong = rng.choice(count, bad, replace=False)
            xy[g, wrong, k] += rng.uniform(60, 300, (bad, 2)) * rng.choice([-1, 1], (bad, 2))
    off = np.linalg.norm(triangulate(rig, xy, sigma_px=sigma).xyz - xyz, axis=-1)
    pulled = np.linalg.norm(triangulate(rig, xy, sigma_px=sigma, weights="none").xyz - xyz, axis=-1)
    # a point lost to two wrong views that happen to agree is the exception
    assert np.quantile(off, 0.98) < 5 * np.median(best)
    assert np.median(pulled) > 10 * np.median(off)


def test_the_middle_residual_is_that_of_good_views_when_half_of_eight_are_wrong():
    """As large as the good ones are (1: two degrees of freedom, of eight residuals), whatever the others."""
    rng = np.random.default_rng(12)
    squares = rng.chisquare(2, (400, 8))
    good = np.median([middle_residual(one.copy(), 8) for one in squares])
    squares[:, :4] += 1e4
    half = np.median([middle_residual(one.copy(), 8) for one in squares])
    assert 0.7 < good < 1.5 and half < 5 * good


def test_a_stated_sigma_that_is_far_too_small_is_seen_through(ring_rig):
    rig = ring_rig(6)
    xyz = cloud(0, 50, 17)
    xy = pixels(rig, xyz, 6.0)
    right = triangulate(rig, xy, sigma_px=np.full(xy.shape[:-1], 6.0))
    wrong = triangulate(rig, xy, sigma_px=np.full(xy.shape[:-1], 1.0))
    off = [np.linalg.norm(found.xyz - xyz, axis=-1).mean() for found in (right, wrong)]
    assert off[1] < 1.1 * off[0]
    ratio = np.trace(wrong.cov, axis1=-2, axis2=-1) / np.trace(right.cov, axis1=-2, axis2=-1)
    assert 0.7 < np.median(ratio) < 1.5


def test_a_rig_that_is_calibrated_badly_costs_no_more_than_plain_least_squares(ring_rig):
    """Every view disagrees with every other by far more than it states: no person is an outlier, the scale is wrong."""
    rig, rng = ring_rig(4), np.random.default_rng(4)
    xyz = cloud(0, 30, 17)
    xy = pixels(rig, xyz, 2.0)
    wrong = rig
    for camera in range(len(rig)):
        wrong = turned(wrong, camera, np.deg2rad(2.5) * rng.normal(size=3))
    found, plain = (triangulate(wrong, xy, sigma_px=np.full(xy.shape[:-1], 2.0), weights=w) for w in ("robust", "none"))
    off = [np.linalg.norm(one.xyz - xyz, axis=-1) for one in (found, plain)]
    assert np.isfinite(off[0]).all()
    assert off[0].mean() < 1.1 * off[1].mean()


def test_unstated_sigma_comes_from_the_size_of_the_body_and_the_score(ring_rig):
    rig = ring_rig(4)
    xyz = cloud(0, 9)
    xy = pixels(rig, xyz)
    extent = (xy.max(axis=1) - xy.min(axis=1)).max(axis=1)
    stated = np.broadcast_to(0.015 * extent[:, None] / 0.5, xy.shape[:-1])
    score = np.full(xy.shape[:-1], 0.5)
    np.testing.assert_allclose(triangulate(rig, xy, score).cov, triangulate(rig, xy, score, stated).cov, rtol=1e-12)


def test_reprojection_error_is_in_raw_pixels_of_the_used_views(ring_rig):
    rig = ring_rig(5, distortion=LENSES[12])
    xyz = cloud(0, 6)
    xy = pixels(rig, xyz, 2.0)
    xy[1, 2] += 150
    found = triangulate(rig, xy, sigma_px=np.full(xy.shape[:-1], 2.0))
    distance = np.linalg.norm(rig.project(found.xyz) - xy, axis=-1)
    assert found.n_views.tolist() == [5, 5, 4, 5, 5, 5]
    distance[1, 2] = np.nan
    np.testing.assert_allclose(found.reproj, np.sqrt(np.nanmean(distance**2, axis=0)), rtol=1e-9)


def test_uncertainty_grows_along_nearly_parallel_rays(ring_rig):
    camera = ring_rig(4).cameras[0]
    beside = replace(camera, name="beside", cam_from_world=SE3.from_rotvec([0, 0, 0], [0.02, 0, 0]) @ camera.cam_from_world)
    rig = Rig((camera, beside))
    xyz = cloud(0, 5)
    _, cov, _ = triangulate(rig, pixels(rig, xyz), sigma_px=np.ones((2, 5)))
    values, axes = np.linalg.eigh(cov)
    ray = xyz - camera.centre_world
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    assert (np.sqrt(values[:, 2]) > 1.0).all()
    assert (np.abs((axes[..., 2] * ray).sum(axis=-1)) > 0.99).all()


def test_errors_say_what_was_expected(ring_rig):
    rig = ring_rig(4)
    good = np.zeros((2, 4, 5, 2))
    refusal(ShapeError, r"C = 4 cameras, got shape \(2, 3, 5, 2\)", triangulate, rig, good[:, :3])
    refusal(ShapeError, r"score: expected .* = \(2, 4, 5\), got shape \(2, 4, 6\)", triangulate, rig, good, np.ones((2, 4, 6)))
    refusal(ConfigError, "expected one of none, score, all, robust, got 'best'", triangulate, rig, good, weights="best")
    refusal(ConfigError, "skeleton=", triangulate, rig, good, weights="all")


@pytest.mark.parametrize("weights", WEIGHTS)
def test_input_is_left_as_it_was(ring_rig, weights):
    rig = ring_rig(4)
    xy = pixels(rig, STANDING)
    score = np.full(xy.shape[:-1], np.nan)
    before = xy.copy()
    triangulate(rig, xy, score, weights=weights, skeleton=COCO)
    np.testing.assert_array_equal(xy, before)
    assert np.isnan(score).all()


def test_two_pairs_of_views_that_say_different_things_are_no_point(ring_rig):
    """Two cameras see the truth, two agree on another place: invented either way. A fifth decides."""
    truth, elsewhere = np.array([[0.1, 0.2, 1.0]]), np.array([[0.5, -0.3, 1.4]])
    for count in (4, 5):
        rig = ring_rig(count)
        xy = rig.project(truth)
        xy[:2] = rig.project(elsewhere)[:2]
        found = triangulate(rig, xy, sigma_px=np.ones((count, 1)))
        if count == 4:
            assert np.isnan(found.xyz).all()
            assert found.n_views.tolist() == [0]
        else:
            np.testing.assert_allclose(found.xyz, truth, atol=1e-6)
            assert found.n_views.tolist() == [3]


# --- weights


def test_distance_weight_is_a_trapezoid():
    settings = FuseSettings(distance_min_m=2, distance_max_m=5, distance_fall_m=2)
    away = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 6.0, 7.0, 9.0])
    np.testing.assert_allclose(distance_weight(away, settings), [0, 0.5, 1, 1, 1, 0.5, 0, 0])


def test_side_view_is_large_across_and_small_along_the_optical_axis(ring_rig):
    rig, skeleton = ring_rig(3), COCO
    pose = STANDING.copy()
    elbow, wrist = skeleton.index("left_elbow"), skeleton.index("left_wrist")
    optical = rig.cameras[1].cam_from_world.matrix()[2]
    pose[elbow] = pose[wrist] + 0.25 * optical
    assert side_view(rig, skeleton, pose)[1, wrist] == pytest.approx(0, abs=1e-12)
    pose[elbow] = pose[wrist] + 0.25 * rig.cameras[1].cam_from_world.matrix()[0]
    assert side_view(rig, skeleton, pose)[1, wrist] == pytest.approx(1, abs=1e-12)
    assert (side_view(rig, skeleton, pose)[:, skeleton.index("nose")] == 1).all()
    with_segment = [name in SEGMENT_OF for name in skeleton.keypoints]
    assert ((side_view(rig, skeleton, STANDING) < 1).any(axis=0) == with_segment).all()


def test_a_missing_segment_leaves_distance_alone_to_decide(ring_rig):
    rig, skeleton = ring_rig(3), COCO
    wrist = skeleton.index("left_wrist")
    pose = STANDING.copy()
    pose[skeleton.index("left_elbow")] = np.nan
    settings = FuseSettings(distance_min_m=0.5, distance_max_m=1.0, distance_fall_m=10.0)
    away = np.linalg.norm(pose[wrist] - rig.centres_world(), axis=-1)
    weight = full_weight(rig, skeleton, np.full((3, 17), 0.8), pose, settings)
    np.testing.assert_allclose(weight[:, wrist], 0.64 * distance_weight(away, settings))
    pose[wrist] = np.nan
    np.testing.assert_allclose(full_weight(rig, skeleton, np.full((3, 17), 0.8), pose, settings)[:, wrist], 0.64)


FACE = {
    "brow", "chin", "ear", "eye", "eye_inner", "eye_outer", "head", "inner_lip_lower", "inner_lip_upper", "inner_mouth", "jaw",
    "lid_lower", "lid_upper", "lip_lower", "lip_upper", "mouth", "nose", "nose_base", "nose_bridge", "nostril",
}  # fmt: skip
FINGERS = {"hand_root", "thumb", "index", "middle", "ring", "pinky"}


@pytest.mark.parametrize("name", SKELETONS)
def test_every_body_keypoint_belongs_to_a_segment(name):
    skeleton = SKELETONS[name]
    loose = {re.sub(r"^(left|right)_|\d+$", "", k) for k in skeleton.keypoints if k not in SEGMENT_OF}
    assert loose <= FACE | FINGERS
    assert {SEGMENT_OF[k] for k in skeleton.keypoints if k in SEGMENT_OF} == set(SEGMENTS)
