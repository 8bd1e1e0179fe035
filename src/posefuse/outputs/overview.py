"""Output ``overview``: one image of a result, views and 3D, for a report or a README."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Le

from posefuse.core import SE3, Camera, Kind, Recording
from posefuse.core.arrays import Array
from posefuse.foundation.output_file import atomic_file
from posefuse.foundation.settings import settings

from .drawing import EMPTY_RGB, draw_legend, draw_name, draw_skeleton, draw_text, draw_views, grid_for, keypoint_colours
from .frames import Frames, ImageOutput, ShowStep

_GROUND_RGB = (70, 74, 84)
_CAMERA_RGB = (200, 205, 215)
_WARNING_RGB = (250, 110, 90)
_AXES_RGB = ((230, 90, 90), (100, 200, 100), (100, 140, 240))
_CAMERA_DEPTH_M = 0.35
_ELLIPSE_POINTS = 24
_ELLIPSE_SIGMAS = 3.0
# where the bystander may stand, how high for one metre away, and how much of the image stays empty
_AZIMUTHS = 24
_RISE = 0.45
_MARGIN = 0.09


def stage_picture(recording: Recording, i: int, size_wh: tuple[int, int]) -> Array:
    """RGB image (H, W, 3) of time step i: people with 3-sigma ellipses, cameras, the floor."""
    view = bystander(recording, i, size_wh)
    picture = np.full((size_wh[1], size_wh[0], 3), EMPTY_RGB, np.uint8)
    _floor(picture, view, recording)
    for camera in recording.rig:
        _frustum(picture, view, camera)
    for axis, colour in zip(np.eye(3) * 0.5, _AXES_RGB, strict=True):
        _lines(picture, view, np.array([np.zeros(3), axis]), colour, 2)
    poses = recording.poses
    for n in range(len(poses.person_id)):
        _ellipses(picture, view, poses.xyz_world[i, n], poses.cov_world[i, n], keypoint_colours(poses.skeleton))
        draw_skeleton(picture, view.project(poses.xyz_world[i, n]), poses.kind[i, n], poses.skeleton)
    for n in range(len(poses.person_id)):
        draw_name(picture, view.project(poses.xyz_world[i, n]), recording, n)
    draw_text(picture, f"{len(recording.rig)} cameras, floor in metres, 3-sigma ellipses", 0)
    draw_legend(picture, 1)
    if recording.rig.refused:
        draw_text(picture, "this calibration was refused: do not trust positions", 3, _WARNING_RGB)
    return picture


def bystander(recording: Recording, i: int, size_wh: tuple[int, int]) -> Camera:
    """A camera that looks down at people and cameras, all of them in the image, from where they appear largest."""
    seen = recording.poses.xyz_world[i].reshape(-1, 3)
    points = np.concatenate([recording.rig.centres_world(), seen[np.isfinite(seen).all(axis=-1)]])
    azimuths = np.linspace(0, 2 * np.pi, _AZIMUTHS, endpoint=False)
    views = [_looking_at(points, azimuth, size_wh) for azimuth in azimuths]
    return min(views, key=lambda view: float(np.linalg.norm(view.centre_world - points.mean(axis=0))))


def _looking_at(points: Array, azimuth_rad: float, size_wh: tuple[int, int]) -> Camera:
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    backward = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), _RISE])
    backward /= np.linalg.norm(backward)
    right = np.cross(-backward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(-backward, right), -backward])
    focal = 1.4 * min(size_wh)
    matrix = np.array([[focal, 0, (size_wh[0] - 1) / 2], [0, focal, (size_wh[1] - 1) / 2], [0, 0, 1.0]])
    local = (points - middle) @ rotation.T
    half = (np.array(size_wh) / 2 - _MARGIN * min(size_wh)) / focal
    distance = max(1.0, float((np.abs(local[:, :2]) / half - local[:, 2:]).max()))
    return Camera(
        name="bystander",
        size_wh=size_wh,
        K=matrix,
        cam_from_world=SE3.from_matrix(rotation, -rotation @ (middle + backward * distance)),
    )


def _floor(picture: Array, view: Camera, recording: Recording) -> None:
    reach = np.concatenate([recording.rig.centres_world()[:, :2], np.zeros((1, 2))])
    low, high = np.floor(reach.min(axis=0)).astype(int), np.ceil(reach.max(axis=0)).astype(int)
    for x in range(low[0], high[0] + 1):
        _lines(picture, view, np.array([[x, low[1], 0], [x, high[1], 0]], float), _GROUND_RGB, 1)
    for y in range(low[1], high[1] + 1):
        _lines(picture, view, np.array([[low[0], y, 0], [high[0], y, 0]], float), _GROUND_RGB, 1)


def _frustum(picture: Array, view: Camera, camera: Camera) -> None:
    import cv2

    width, height = camera.size_wh
    corners_img = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], float)
    corners_norm = (corners_img - camera.K[:2, 2]) / [camera.K[0, 0], camera.K[1, 1]]
    corners_cam = np.concatenate([corners_norm, np.ones((4, 1))], axis=1) * _CAMERA_DEPTH_M
    corners = camera.cam_from_world.inverse() @ corners_cam
    for corner in corners:
        _lines(picture, view, np.array([camera.centre_world, corner]), _CAMERA_RGB, 1)
    _lines(picture, view, corners[[0, 1, 2, 3, 0]], _CAMERA_RGB, 1)
    at = view.project(camera.centre_world)
    if np.isfinite(at).all():
        place = (int(at[0]) + 8, int(at[1]) - 8)
        cv2.putText(picture, camera.name, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, _CAMERA_RGB, 1, cv2.LINE_AA)


def _ellipses(picture: Array, view: Camera, xyz: Array, cov: Array, colours: list[tuple[int, int, int]]) -> None:
    """Outlines of the ellipsoids: the covariance as the view's image plane sees it."""
    import cv2

    angle = np.linspace(0, 2 * np.pi, _ELLIPSE_POINTS)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    rotation = view.cam_from_world.matrix()
    for point, sigma, colour in zip(xyz, cov, colours, strict=True):
        if not (np.isfinite(point).all() and np.isfinite(sigma).all()):
            continue
        x, y, z = view.cam_from_world @ point
        slope = np.array([[1 / z, 0, -x / z**2], [0, 1 / z, -y / z**2]]) * view.K[0, 0]
        values, vectors = np.linalg.eigh(slope @ rotation @ sigma @ rotation.T @ slope.T)
        outline = view.project(point)[:, None] + _ELLIPSE_SIGMAS * (vectors * np.sqrt(values.clip(0))) @ circle
        if np.isfinite(outline).all() and np.abs(outline).max() < 1e5:
            cv2.polylines(picture, [np.round(outline.T * 16).astype(np.int32)], True, colour, 1, cv2.LINE_AA, 4)


def _lines(picture: Array, view: Camera, xyz_world: Array, colour: tuple[int, ...], width: int) -> None:
    import cv2

    xy = view.project(xyz_world)
    for a, b in pairwise(xy):
        if np.isfinite([a, b]).all() and max(np.abs(a).max(), np.abs(b).max()) < 1e5:
            ends = [tuple(int(value) for value in np.round(end * 16)) for end in (a, b)]
            cv2.line(picture, ends[0], ends[1], colour, width, cv2.LINE_AA, 4)


@settings
class OverviewSink(ImageOutput):
    """``overview.png``: the best seen time step near the middle in every view, and the scene in 3D next to them.

    Attributes:
        width_px, height_px: the views fit into this; the 3D image next to them has the same height.
    """

    width_px: Annotated[int, Ge(64), Le(7680)] = 1280
    height_px: Annotated[int, Ge(64), Le(4320)] = 720
    name: ClassVar[str] = "overview"
    file: ClassVar[str] = "overview.png"

    @contextmanager
    def showing(self, recording: Recording, path: Path) -> Iterator[ShowStep]:
        """The frames of one time step are kept for the end."""
        import cv2

        chosen, images = best_time_step(recording), list[Array | None]([None] * len(recording.rig))

        def show(i: int, frames: Frames) -> None:
            if i == chosen:
                images[:] = [None if frame is None else frame.image for frame in frames]

        yield show
        picture = cv2.cvtColor(self._picture(recording, chosen, images), cv2.COLOR_RGB2BGR)
        with atomic_file(path) as staged:
            staged.write_bytes(cv2.imencode(".png", picture)[1].tobytes())

    def _picture(self, recording: Recording, i: int, images: Sequence[Array | None]) -> Array:
        grid = grid_for([camera.size_wh for camera in recording.rig], (self.width_px, self.height_px))
        width, height = grid.size_wh
        stage_width = max(320, min(height, width))
        picture = np.full((height, width + stage_width, 3), EMPTY_RGB, np.uint8)
        draw_views(picture, grid, recording, i, images)
        picture[:, width:] = stage_picture(recording, i, (stage_width, height))
        return picture


def best_time_step(recording: Recording) -> int:
    """The time step with the most measured keypoints; among equals the one nearest to the middle."""
    kind = recording.poses.kind
    measured = ((kind == Kind.FUSED) | (kind == Kind.SMOOTHED)).sum(axis=(1, 2))
    from_middle = np.abs(np.arange(len(kind)) - (len(kind) - 1) / 2) / max(1, len(kind))
    return int(np.argmax(measured - from_middle))
