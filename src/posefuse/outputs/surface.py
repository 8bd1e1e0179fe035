"""The surface of a person drawn into a camera's image, without a graphics card."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from posefuse.core import Camera
from posefuse.core.arrays import Array

from .frames import FrameSink

_RGB = np.array([196.0, 204.0, 216.0])
# of the colour, where the surface is seen at a grazing angle
_DARKEST = 0.35
_OPACITY = 0.6
_NEAREST_M = 0.1
# px; OpenCV's coordinates overflow far outside
_FAR_PX = 30_000
_SHIFT = 4


@dataclass(frozen=True, eq=False)
class BodySurface:
    """One person's surface over time.

    Attributes:
        faces: (F, 3) vertices of each triangle, counter-clockwise seen from outside.
        vertices_at: (V, 3) world metres at a time step of the recording.
    """

    faces: Array
    vertices_at: Callable[[int], Array]


@runtime_checkable
class SurfaceSink(FrameSink, Protocol):
    """An output that can draw people's surfaces."""

    def with_surfaces(self, surfaces: tuple[BodySurface, ...]) -> FrameSink:
        """The output that draws these."""
        ...


def draw_surface(tile: Array, camera: Camera, scale: float, vertices_world: Array, faces: Array) -> None:
    """Draw a surface translucently into a tile (H, W, 3) that shows the camera's image at this scale, top left.

    Painter's algorithm: triangles that face the camera, the farthest first, lit from the camera. Triangles that reach behind
    the camera are left out.
    """
    import cv2

    in_camera = camera.cam_from_world @ vertices_world
    # pixel centres are integers: the corner of the image is at -0.5
    xy = (camera.project(vertices_world) + 0.5) * scale - 0.5
    good = np.isfinite(xy).all(axis=-1) & (np.abs(np.nan_to_num(xy)) < _FAR_PX).all(axis=-1) & (in_camera[:, 2] > _NEAREST_M)
    corners = in_camera[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middle = corners.mean(axis=1)
    towards = -(normal * middle).sum(axis=-1)
    size = np.linalg.norm(normal, axis=-1) * np.linalg.norm(middle, axis=-1)
    shown = np.flatnonzero(good[faces].all(axis=-1) & (towards > 0))
    if not len(shown):
        return
    shown = shown[np.argsort(-middle[shown, 2], kind="stable")]
    light = _DARKEST + (1 - _DARKEST) * towards[shown] / size[shown]
    corners_px = np.round(xy[faces[shown]] * 2**_SHIFT).astype(np.int32)
    painted = tile.copy()
    for corner, colour in zip(corners_px, (light[:, None] * _RGB).tolist(), strict=True):
        cv2.fillConvexPoly(painted, corner, colour, cv2.LINE_8, _SHIFT)
    cv2.addWeighted(painted, _OPACITY, tile, 1 - _OPACITY, 0, dst=tile)
