import cv2
import numpy as np
import pytest
from built import camera

from posefuse.core import SE3, Rig
from posefuse.fusion import triangulate
from posefuse.fusion.kernels import lens
from posefuse.fusion.kernels.lens import packed_rig

K = np.array([[700.0, 0.0, 320.0], [0, 690.0, 240.0], [0, 0, 1]])
BROWN = [-0.2, 0.05, 0.001, -0.002, 0.01, 0.02, -0.01, 0.005, 0.001, -0.002, 0.003, -0.001, 0.02, -0.03]
FISH = [-0.03, 0.01, -0.004, 0.001]


@pytest.mark.parametrize("weights", ["none", "robust"])
def test_two_clean_views_agree_with_triangulate_points(ring_rig, weights):
    rig = Rig(ring_rig(5).cameras[:2])
    xyz = np.random.default_rng(0).normal(size=(9, 3)) * 0.4 + [0, 0, 1]
    xy = rig.project(xyz)
    homogeneous = cv2.triangulatePoints(*rig.projections(), xy[0].T.copy(), xy[1].T.copy())
    np.testing.assert_allclose(triangulate(rig, xy, weights=weights).xyz, (homogeneous[:3] / homogeneous[3]).T, atol=1e-7)


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12, 14])
def test_the_compiled_lens_is_opencvs_and_its_inverse_exact(count):
    packed = packed_rig(Rig((camera(K, BROWN[:count]),)))[0]
    xy = np.random.default_rng(1).uniform(-0.35, 0.35, (20, 2))
    expected, _ = cv2.projectPoints(np.column_stack([xy, np.ones(20)]), np.zeros(3), np.zeros(3), K, np.array(BROWN[:count]))
    for ideal, raw in zip(xy, expected[:, 0], strict=True):
        np.testing.assert_allclose(lens.bend(packed, *ideal)[:2], raw, atol=1e-9)
        np.testing.assert_allclose(lens.straighten(packed, *raw)[:2], ideal, atol=1e-12)
    side_by_side = np.empty((1, 6, 20))
    lens.straighten_group(packed[None], np.ascontiguousarray(expected[:, 0])[None], side_by_side, np.empty(20))
    np.testing.assert_allclose(side_by_side[0, :2].T, xy, atol=1e-12)


def test_the_compiled_fisheye_is_opencvs_and_its_inverse_exact():
    packed = packed_rig(Rig((camera(K, FISH, model="fisheye"),)))[0]
    xy = np.random.default_rng(1).uniform(-2.0, 2.0, (20, 2))
    expected = cv2.fisheye.distortPoints(xy[None], K, np.array(FISH))[0]
    for ideal, raw in zip(xy, expected, strict=True):
        np.testing.assert_allclose(lens.bend(packed, *ideal)[:2], raw, atol=1e-9)
        np.testing.assert_allclose(lens.straighten(packed, *raw)[:2], ideal, atol=1e-10)


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_the_compiled_lens_gives_up_where_the_camera_does(model):
    """Far outside the image there is no inverse: NaN in both, or the same ray."""
    lens_of = camera(K, [-0.4, 0.0, 0.0, 0.0] if model == "pinhole" else [-0.3, 0.01, 0.0, 0.0], model=model)
    packed = packed_rig(Rig((lens_of,)))[0]
    xy = np.random.default_rng(2).uniform(-1500, 2000, (200, 2))
    expected = lens_of.norm_from_px(xy)
    ideal = np.empty((1, 6, len(xy)))
    lens.straighten_group(packed[None], xy[None], ideal, np.empty(len(xy)))
    found = ideal[0, :2].T
    np.testing.assert_allclose(found, expected, atol=1e-7)
    assert 0 < np.isnan(expected[:, 0]).sum() < 200


# --- the lens models of cameras against OpenCV's, and their inverse against themselves


ODD_K = np.array([[810.0, 0, 322.5], [0, 790.0, 236.25], [0, 0, 1]])
COEFFICIENTS = {
    4: [-0.28, 0.09, 0.001, -0.002],
    5: [-0.28, 0.09, 0.001, -0.002, -0.01],
    8: [-0.2, 0.05, 0.001, -0.002, -0.01, 0.04, 0.02, -0.003],
    12: [-0.2, 0.05, 0.001, -0.002, -0.01, 0.04, 0.02, -0.003, 0.002, -0.001, 0.003, 0.0005],
    14: [-0.2, 0.05, 0.001, -0.002, -0.01, 0.04, 0.02, -0.003, 0.002, -0.001, 0.003, 0.0005, 0.02, -0.03],
}


def points_in_view(count: int) -> np.ndarray:
    rng = np.random.default_rng(1)
    return rng.uniform([-0.4, -0.3, 1], [0.4, 0.3, 1], (count, 3)) * rng.uniform(1.5, 6, (count, 1))


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12, 14])
def test_pinhole_projects_as_opencv(count: int) -> None:
    rvec, t, k = np.array([0.3, -0.2, 0.5]), np.array([0.1, -0.2, 0.3]), np.array(COEFFICIENTS.get(count, []))
    pose = SE3.from_rotvec(rvec, t)
    world = pose.inverse() @ points_in_view(200)
    expected = cv2.projectPoints(world, rvec, t, ODD_K, k if count else None)[0][:, 0]
    assert np.allclose(camera(ODD_K, k, pose).project(world), expected, atol=1e-8)


def test_fisheye_projects_as_opencv() -> None:
    k = np.array([0.05, -0.02, 0.004, -0.001])
    world = points_in_view(200) * [2.5, 2.5, 1]
    fish = camera(ODD_K, k, model="fisheye")
    expected = cv2.fisheye.projectPoints(world[:, None], np.zeros(3), np.zeros(3), ODD_K, k)[0][:, 0]
    assert np.allclose(fish.project(world), expected, atol=1e-8)
    assert np.allclose(fish.norm_from_px(expected), world[:, :2] / world[:, 2:], atol=1e-8)


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12, 14])
def test_undistorting_is_the_exact_inverse(count: int) -> None:
    lens = camera(ODD_K, COEFFICIENTS.get(count, []))
    grid = np.stack(np.meshgrid(np.linspace(0, 639, 17), np.linspace(0, 479, 13)), -1)
    assert np.allclose(lens.px_from_norm(lens.norm_from_px(grid)), grid, atol=1e-7)


def test_where_the_lens_cannot_be_inverted_is_nan_not_a_wrong_ray() -> None:
    ok, beyond = camera(ODD_K, [-0.9, 0.0, 0.0, 0.0]).norm_from_px(np.array([[330.0, 240.0], [3000.0, 240.0]]))
    assert np.isfinite(ok).all()
    assert np.isnan(beyond).all()
