"""A person's surface in a picture: where the camera projects it, near parts over far ones, and nothing else changed."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from posefuse.core import SE3, Camera, Recording
from posefuse.outputs.overlay import OverlaySink
from posefuse.outputs.surface import BodySurface, SurfaceSink, draw_surface

CAMERA = Camera(
    name="one",
    size_wh=(160, 120),
    K=np.array([[100.0, 0, 79.5], [0, 100.0, 59.5], [0, 0, 1]]),
    cam_from_world=SE3.from_matrix(np.eye(3), np.zeros(3)),
)
# a square two metres ahead, seen from its outside: half a metre from the middle each way
SQUARE = np.array([[-0.5, -0.5, 2.0], [0.5, -0.5, 2.0], [0.5, 0.5, 2.0], [-0.5, 0.5, 2.0]])
OUTWARD = np.array([[0, 2, 1], [0, 3, 2]])


def drawn(vertices: np.ndarray, faces: np.ndarray, scale: float = 1.0) -> np.ndarray:
    tile = np.zeros((120, 160, 3), np.uint8)
    draw_surface(tile, CAMERA, scale, vertices, faces)
    return tile


def test_it_covers_what_the_camera_projects_it_to() -> None:
    inside = np.zeros((120, 160), bool)
    inside[36:84, 56:104] = True
    covered = drawn(SQUARE, OUTWARD).any(axis=-1)
    assert covered[inside].all()
    around = np.zeros_like(inside)
    around[33:87, 53:107] = True
    assert not covered[~around].any()


def test_half_the_scale_is_half_as_large() -> None:
    full, half = (int(drawn(SQUARE, OUTWARD, scale).any(axis=-1).sum()) for scale in (1.0, 0.5))
    assert half == pytest.approx(full / 4, rel=0.1)


def test_faces_seen_from_inside_and_behind_the_camera_are_not_drawn() -> None:
    assert not drawn(SQUARE, OUTWARD[:, ::-1]).any()
    assert not drawn(SQUARE * [1, 1, -1], OUTWARD).any()
    assert not drawn(np.full_like(SQUARE, np.nan), OUTWARD).any()


def test_the_near_surface_hides_the_far_one_whatever_their_order() -> None:
    # the far one is seen at a grazing angle and therefore darker
    far = SQUARE @ np.array([[1, 0, 0], [0, 1, 0], [2.0, 0, 1]]) + [-4, 0, 1.5]
    both, faces = np.concatenate([SQUARE, far]), np.concatenate([OUTWARD, OUTWARD + 4])
    alone = drawn(SQUARE, OUTWARD)
    for order in (faces, faces[::-1]):
        np.testing.assert_array_equal(drawn(both, order)[40:80, 60:100], alone[40:80, 60:100])


def test_the_overlay_takes_surfaces_and_draws_them(tmp_path: Path, make_recording: Callable[..., Recording]) -> None:
    recording = make_recording(cameras=2)
    asked: list[int] = []
    plain = OverlaySink(width_px=320, height_px=240)
    assert isinstance(plain, SurfaceSink)

    def vertices_at(i: int) -> np.ndarray:
        asked.append(i)
        return SQUARE

    sink = plain.with_surfaces((BodySurface(faces=OUTWARD, vertices_at=vertices_at),))
    assert sink.name == plain.name == "overlay"
    [path] = sink.write(recording, tmp_path)
    assert path.name == "overlay.mp4" and asked == list(range(len(recording.poses)))
