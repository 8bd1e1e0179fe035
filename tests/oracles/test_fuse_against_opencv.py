import cv2
import numpy as np
import pytest
from built import camera

from posefuse.core import SE3, Rig
from posefuse.fusion import triangulate


@pytest.mark.parametrize("weights", ["none", "robust"])
def test_two_clean_views_agree_with_triangulate_points(ring_rig, weights):
    rig = Rig(ring_rig(5).cameras[:2])
    xyz = np.random.default_rng(0).normal(size=(9, 3)) * 0.4 + [0, 0, 1]
    xy = rig.project(xyz)
    homogeneous = cv2.triangulatePoints(*rig.projections(), xy[0].T.copy(), xy[1].T.copy())
    np.testing.assert_allclose(triangulate(rig, xy, weights=weights).xyz, (homogeneous[:3] / homogeneous[3]).T, atol=1e-7)


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
