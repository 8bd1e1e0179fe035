"""A rig that is planned: a room with cameras one by one, and how exact it will be before it is built.

The covariance of a point is the inverse of the information of its views, ``inv(sum J' J / sigma^2)``, with J the derivative of
the pixels by the point: what fusion states for views that are all used. The standard deviation of a view is that of a detector
that states none (`FuseSettings.sigma_share` of the size of a standing person in that image).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from posefuse.core import Camera, ConfigError, InputError, Rig
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.foundation.summary import Block, Facts, Heading
from posefuse.fusion import FuseSettings
from posefuse.fusion.triangulation import sigma_of_size
from posefuse_sim.cameras import ListedCameras, PlacedCamera, RingCameras, placed_cameras, rig_from_cameras
from posefuse_sim.motion.settings import RandomPath, WalkSettings
from posefuse_sim.scene import PersonSettings, Scene
from posefuse_sim.surroundings import Box, RoomSettings

_ROOM_M = (7.0, 7.0)
# part of the room that a walk keeps to, and the least that a random path needs
_WALKED, _LEAST_HALF_M = 0.5, 1.0
# between a camera and the wall behind it
_WALL_M = 0.2


def first_plan(count: int = 4) -> Scene:
    """A room with cameras in a ring; a start to change."""
    ring = RingCameras(kind="ring", count=count, radius_m=_ROOM_M[0] / 2 - _WALL_M, height_m=2.2, first_angle_deg=45.0)
    return listed_cameras(Scene(duration_s=6.0, cameras=ring, room=RoomSettings(size_m=_ROOM_M)))


def listed_cameras(scene: Scene) -> Scene:
    """The same scene with every camera by itself, so that each can be moved."""
    return replace(scene, cameras=ListedCameras(kind="list", cameras=placed_cameras(scene.cameras)))


def rig_of_scene(scene: Scene) -> Rig:
    """Its exact cameras; raises ConfigError for one that cannot be."""
    return rig_from_cameras(placed_cameras(scene.cameras))


def camera_of(scene: Scene, name: str) -> PlacedCamera:
    """By name; raises ConfigError where there is none."""
    placed = {camera.name: camera for camera in placed_cameras(scene.cameras)}
    if name not in placed:
        raise ConfigError(f"no camera {name!r}; there are: {choices(placed)}")
    return placed[name]


def with_camera(scene: Scene, camera: PlacedCamera) -> Scene:
    """With this camera in place of the one of its name, or at the end; raises ConfigError for one that cannot be."""
    rig_from_cameras((camera,))
    placed = {one.name: one for one in placed_cameras(scene.cameras)} | {camera.name: camera}
    return replace(scene, cameras=ListedCameras(kind="list", cameras=tuple(placed.values())))


def without_camera(scene: Scene, name: str) -> Scene:
    """Without this camera; raises ConfigError for the last one."""
    cameras = tuple(one for one in placed_cameras(scene.cameras) if one.name != name)
    if not cameras:
        raise ConfigError("a rig needs a camera; add another one before this one is removed")
    return replace(scene, cameras=ListedCameras(kind="list", cameras=cameras))


def free_camera_name(scene: Scene) -> str:
    """``cam00``, ``cam01``, ...: the first that no camera has."""
    taken = {camera.name for camera in placed_cameras(scene.cameras)}
    return next(name for i in range(len(taken) + 1) if (name := f"cam{i:02d}") not in taken)


def with_test_walk(scene: Scene, duration_s: float) -> Scene:
    """With one person who walks around the middle of the room for this time, at a usual speed."""
    size_m = scene.room.size_m or _ROOM_M
    half_x, half_y = (max(_LEAST_HALF_M, _WALKED * size / 2) for size in size_m)
    path = RandomPath(shape="random", low_m=(-half_x, -half_y), high_m=(half_x, half_y))
    person = PersonSettings(motion=WalkSettings(kind="walk", path=path))
    return replace(scene, duration_s=duration_s, people=(person,))


# a standing adult: edges of the box around the body
_BODY_M = (0.5, 0.5, 1.75)
# ankles, knees, hips, head
HEIGHTS_M = (0.1, 0.5, 1.0, 1.6)
_MOST_POINTS = 250_000
_DIFFERENCE_M = 1e-4
_LEAST_VIEWS = 2


@dataclass(frozen=True, eq=False, kw_only=True)
class RigPlan:
    """Coverage and expected error of one time step over a volume: noise alone, without occlusion by people or smoothing.

    Attributes:
        x_m: (X,), y_m: (Y,), height_m: (Z,) of the points, world metres.
        n_views: (Y, X, Z) cameras that see a point.
        error_mm: (Y, X, Z) root mean square distance of the measured from the true point; NaN where fewer than two cameras see
            it.
    """

    x_m: Array
    y_m: Array
    height_m: Array
    n_views: Array
    error_mm: Array

    @property
    def views_map(self) -> Array:
        """(Y, X) cameras that see all heights: the least over them."""
        return np.asarray(self.n_views.min(axis=-1))

    @property
    def error_map_mm(self) -> Array:
        """(Y, X) root mean square over the heights; NaN where one of them is seen by fewer than two cameras."""
        return np.asarray(np.sqrt((self.error_mm**2).mean(axis=-1)))

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "area_m": [float(np.ptp(self.x_m)), float(np.ptp(self.y_m))],
            "heights_m": self.height_m.tolist(),
            "covered_by_2": self.covered(2),
            "covered_by_3": self.covered(3),
            "median_mm": self.error_at(0.5),
            "p95_mm": self.error_at(0.95),
        }

    def summary(self) -> list[Block]:
        """Coverage and expected error, for people."""
        found = self.figures
        (width_m, depth_m), (lowest_m, highest_m) = found["area_m"], self.height_m[[0, -1]]
        error = f"median {found['median_mm']:.0f} mm, 95 % below {found['p95_mm']:.0f} mm"
        facts = {
            "floor": f"{width_m:.1f} x {depth_m:.1f} m, {lowest_m:g} to {highest_m:g} m high",
            "seen by 2 cameras or more": f"{found['covered_by_2']:.0%}",
            "seen by 3 cameras or more": f"{found['covered_by_3']:.0%}",
            "keypoint error, one time step": error if found["covered_by_2"] else "no place is seen by 2 cameras at all heights",
        }
        return [Heading("Expected of these cameras"), Facts(facts)]

    def covered(self, views: int = _LEAST_VIEWS) -> float:
        """Share of the floor over which at least so many cameras see all heights."""
        return float((self.views_map >= views).mean())

    def error_at(self, share: float = 0.5) -> float:
        """Millimetres that this share of the covered floor stays below (0.5: the median); NaN where nothing is covered."""
        known = self.error_map_mm[np.isfinite(self.error_map_mm)]
        return float(np.quantile(known, share)) if len(known) else float("nan")


def plan_rig(
    rig: Rig,
    area_m: tuple[float, float],
    *,
    step_m: float = 0.1,
    boxes: Sequence[Box] = (),
    noise: FuseSettings | None = None,
) -> RigPlan:
    """Coverage and expected error over the floor about the world's origin.

    Args:
        rig: the cameras. area_m: (x, y) of the floor. step_m: between points.
        boxes: what hides points. noise: `sigma_share` and `sigma_min_px` are used; None: the defaults.

    Raises:
        InputError: more points than can be computed at once.
    """
    x_m, y_m = (_axis(size, step_m) for size in area_m)
    height_m = np.array(HEIGHTS_M)
    count = len(x_m) * len(y_m) * len(height_m)
    if count > _MOST_POINTS:
        raise InputError(f"plan: expected at most {_MOST_POINTS} points, got {count}; choose a larger step than {step_m:g} m")
    grid = np.stack(np.meshgrid(y_m, x_m, height_m, indexing="ij"), axis=-1)[..., [1, 0, 2]]
    sigma_px = np.stack([_sigma_px(camera, grid[:, :, 0, :2], noise or FuseSettings()) for camera in rig])
    cov, n_views = covariance(rig, grid, np.broadcast_to(sigma_px[..., None], (len(rig), *grid.shape[:-1])), boxes)
    error_mm = 1000 * np.sqrt(np.trace(cov, axis1=-2, axis2=-1))
    return RigPlan(x_m=x_m, y_m=y_m, height_m=height_m, n_views=n_views, error_mm=error_mm)


def covariance(rig: Rig, xyz_world: Array, sigma_px: Array, boxes: Sequence[Box] = ()) -> tuple[Array, Array]:
    """Covariance (..., 3, 3) in square metres of points (..., 3), and how many cameras see each (...).

    Args:
        sigma_px: (C, ...) standard deviation per image axis of each camera at each point. boxes: what hides points.

    Returns:
        NaN where fewer than two cameras see a point, or all that do look along one line.
    """
    information = np.zeros((*xyz_world.shape, 3))
    n_views = np.zeros(xyz_world.shape[:-1], np.uint8)
    for camera, sigma in zip(rig, sigma_px, strict=True):
        seen = _sees(camera, xyz_world, boxes)
        slope = np.where(seen[..., None, None], _slope(camera, xyz_world), 0.0) / sigma[..., None, None]
        information += np.swapaxes(slope, -1, -2) @ slope
        n_views += seen
    solvable = (n_views >= _LEAST_VIEWS) & (np.linalg.matrix_rank(information, hermitian=True) == 3)
    inverse = np.linalg.inv(np.where(solvable[..., None, None], information, np.eye(3)))
    return np.where(solvable[..., None, None], inverse, np.nan), n_views


def _axis(size_m: float, step_m: float) -> Array:
    """Places of equal distance about 0 that fill a side."""
    count = max(2, round(size_m / step_m) + 1)
    return np.linspace(-size_m / 2, size_m / 2, count)


def _sees(camera: Camera, xyz_world: Array, boxes: Sequence[Box]) -> Array:
    """(...) whether points lie in the image and no box stands before them."""
    seen = camera.sees(xyz_world)
    for box in boxes:
        seen &= ~box.between(camera.centre_world, xyz_world)
    return seen


def _slope(camera: Camera, xyz_world: Array) -> Array:
    """(..., 2, 3) derivative of the raw pixels by the point, through any lens."""
    steps = np.eye(3) * _DIFFERENCE_M
    columns = [(camera.project(xyz_world + step) - camera.project(xyz_world - step)) / (2 * _DIFFERENCE_M) for step in steps]
    return np.stack(columns, axis=-1)


def _sigma_px(camera: Camera, xy_m: Array, noise: FuseSettings) -> Array:
    """(...) standard deviation in this image of a keypoint of a person at positions (..., 2)."""
    half_x, half_y, height = _BODY_M[0] / 2, _BODY_M[1] / 2, _BODY_M[2]
    corners = np.array([(x, y, z) for x in (-half_x, half_x) for y in (-half_y, half_y) for z in (0.0, height)])
    floor = np.concatenate([xy_m, np.zeros((*xy_m.shape[:-1], 1))], axis=-1)
    return sigma_of_size(camera.project(floor[..., None, :] + corners), noise)
