"""docs/conventions.md projects one point by hand; here the code does, with the numbers read from the page."""

import re
from pathlib import Path

import numpy as np

from posefuse.core import SE3, Camera

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
