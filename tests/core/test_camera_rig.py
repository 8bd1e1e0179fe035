"""Cameras and rigs: projection, crops and scales, and every guard."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from checks import refusal

from posefuse.core import SE3, CalibrationError, Camera, Rig

K = np.array([[500.0, 0, 319.5], [0, 510.0, 239.5], [0, 0, 1]])
POSE, LENS = SE3.from_rotvec([0.1, -0.3, 0.2], [0.2, -0.1, 4.0]), np.array([-0.1, 0.02, 0.001, 0.0])
CAMERA = Camera(name="a", size_wh=(640, 480), K=K, cam_from_world=POSE, distortion=LENS)
POINTS = np.random.default_rng(3).uniform(-0.7, 0.7, (5, 2, 3))


def test_rays_go_through_the_points() -> None:
    rays = CAMERA.rays_world(CAMERA.project(POINTS))
    to_point = POINTS - CAMERA.centre_world
    assert np.allclose(rays, to_point / np.linalg.norm(to_point, axis=-1, keepdims=True), atol=1e-9)
    assert np.allclose(CAMERA.depth(POINTS), (CAMERA.cam_from_world @ POINTS)[..., 2])


@pytest.mark.parametrize("k1", [0.0, -0.3, 0.2])
def test_a_camera_sees_what_lies_on_the_rays_of_its_pixels(k1: float) -> None:
    camera = replace(CAMERA, distortion=np.array([k1, 0.0, 0.0, 0.0]))
    x, y = np.meshgrid(np.linspace(-0.49, 639.49, 33), np.linspace(-0.49, 479.49, 21))
    pixels, metres = np.stack([x, y], axis=-1), np.array([1.0, 5.0])[:, None, None, None]
    rays = camera.rays_world(pixels)
    inside, known = camera.centre_world + metres * rays, np.isfinite(rays).all(axis=-1)
    assert known.mean() > 0.9
    np.testing.assert_array_equal(camera.sees(inside), np.stack([known] * 2))
    assert not camera.sees(2 * camera.centre_world - inside).any()
    assert not camera.sees(camera.centre_world + camera.rays_world([[-1.0, 200], [641, 200], [300, -1], [300, 480]])).any()
    aside = np.stack([np.linspace(0.9, 40, 300), np.full(300, 0.1), np.ones(300)], axis=-1)
    assert not camera.sees(camera.cam_from_world.inverse() @ aside).any()
    assert not camera.sees(np.full(3, np.nan))


def test_behind_the_camera_is_missing() -> None:
    assert np.isnan(CAMERA.project(CAMERA.cam_from_world.inverse() @ np.array([0.0, 0.1, -2.0]))).all()


def test_undistorted_pixels_obey_the_projection_matrix() -> None:
    homogeneous = np.concatenate([POINTS, np.ones_like(POINTS[..., :1])], -1) @ CAMERA.projection().T
    assert np.allclose(CAMERA.undistort(CAMERA.project(POINTS)), homogeneous[..., :2] / homogeneous[..., 2:], atol=1e-7)


def test_crop_shifts_and_scale_keeps_corners() -> None:
    px = CAMERA.project(POINTS)
    assert np.allclose(CAMERA.cropped(8, 3, (600, 470)).project(POINTS), px - [8, 3])
    half = CAMERA.scaled((320, 160))
    assert half.size_wh == (320, 160)
    assert np.allclose(half.project(POINTS), (px + 0.5) * [1 / 2, 1 / 3] - 0.5)


def test_moving_the_world_moves_the_cameras_with_it() -> None:
    rig = Rig((CAMERA, replace(CAMERA, name="b", cam_from_world=SE3.from_rotvec([0, 0.4, 0], [0, 0, 3.0]))))
    new_from_old = SE3.from_rotvec([0.3, 0.2, -0.5], [1.0, 2.0, 3.0])
    assert np.allclose(rig.moved(new_from_old).project(new_from_old @ POINTS), rig.project(POINTS), atol=1e-8)


def test_rig_id_follows_what_changes_a_projection() -> None:
    rig = Rig((CAMERA,))
    assert rig.id == Rig((replace(CAMERA),), world_set_by="else", residual_px=0.3).id
    assert rig.id != Rig((replace(CAMERA, K=K + np.diag([0.1, 0, 0])),)).id
    assert rig.id != Rig((replace(CAMERA, cam_from_world=SE3.from_rotvec([0.1, -0.3, 0.2], [0.2, -0.1, 4.001])),)).id
    assert len(rig.id) == 12


def test_picking_and_naming() -> None:
    rig = Rig((CAMERA, replace(CAMERA, name="b")))
    assert rig.only(["b", "a"]).names == ("b", "a")
    assert rig.renamed({"a": "front"}).names == ("front", "b")
    refusal(CalibrationError, "no camera 'c'; there are: a, b", lambda: rig["c"])
    refusal(CalibrationError, "at least 1", Rig, ())
    refusal(CalibrationError, "got twice: a", Rig, (CAMERA, CAMERA))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": ""}, "name"),
        ({"size_wh": (0, 480)}, "image size"),
        ({"K": np.diag([np.nan, 500, 1])}, "finite 3x3"),
        ({"K": np.diag([-500.0, 500, 1])}, "fx, fy > 0"),
        ({"K": K.T}, "expected \\[\\[fx"),
        ({"distortion": np.zeros(6)}, "0, 4, 5, 8, 12, 14 coefficients, got 6"),
        ({"distortion": np.zeros(0), "model": "fisheye"}, "expected 4 coefficients, got 0"),
        ({"distortion": np.zeros(5), "model": "fisheye"}, "expected 4 coefficients, got 5"),
        ({"distortion": np.array([np.nan, 0, 0, 0])}, "finite coefficients"),
        ({"model": "panorama"}, "pinhole, fisheye"),
        ({"cam_from_world": SE3([1.0, 0, 0, 0], [np.nan, 0, 0])}, "pose"),
        ({"readout_s": -1.0}, "readout_s"),
    ],
)
def test_a_camera_that_cannot_be_right_is_refused_by_name(change: dict, message: str) -> None:
    refusal(CalibrationError, message, replace, CAMERA, **change)


# --- docs/conventions.md projects one point by hand; here the code does, with the numbers read from the page


PAGE = (Path(__file__).resolve().parents[2] / "docs" / "conventions.md").read_text(encoding="utf-8")


def numbers(pattern: str) -> list[float]:
    found = re.search(pattern, PAGE)
    assert found, f"docs/conventions.md no longer says {pattern!r}"
    return [float(x) for x in re.findall(r"-?\d+\.?\d*", found.group(1))]


def test_the_page_and_the_code_project_the_same_point() -> None:
    centre = np.array(numbers(r"centre_world\s+= (\(.*?\))"))
    world_axes = np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])
    fx, fy, cx, cy = (numbers(rf"{name} = (-?\d+\.?\d*)")[0] for name in ("fx", "fy", "cx", "cy"))
    pose, distortion = SE3.from_matrix(world_axes, -world_axes @ centre), np.array([numbers(r"k1 = (\d+\.\d+)")[0], 0, 0, 0])
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    camera = Camera(name="page", size_wh=(640, 480), K=K, cam_from_world=pose, distortion=distortion)
    point = np.array(numbers(r"`xyz_world = (\(.*?\))`"))
    assert np.allclose(camera.cam_from_world @ point, numbers(r"`xyz_cam = (\(.*?\))`"))
    assert np.allclose(camera.norm_from_px(camera.project(point)), numbers(r"`xy_norm = (\(.*?\))`"))
    assert np.allclose(camera.project(point), numbers(r"`xy_img = (\(.*?\))`"))
