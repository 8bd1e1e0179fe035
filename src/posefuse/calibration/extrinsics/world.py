"""The world frame: Z up, metres, from a tile on the floor, from three measured points, or from feet on the floor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Target
from posefuse.core import SE3, CalibrationError, Rig
from posefuse.core.arrays import Array
from posefuse.core.errors import choices

from .locate import locate_static

_LEAST_TRIANGLE_RAD = np.deg2rad(5)
_FLOOR_CUT_M = 0.04
_FLOOR_ROUNDS = 20
# of the foot points of a person who walks so many are on the floor
_STANDING_SHARE = 0.25


class WorldRule(Protocol):
    """How the world frame comes about."""

    @property
    def words(self) -> str:
        """For `Rig.world_set_by`."""
        ...

    @property
    def has_floor(self) -> bool:
        """Whether z = 0 is the floor."""
        ...

    def new_from_old(self, rig: Rig) -> SE3:
        """The motion that takes the rig's present world to the wanted one."""
        ...


@dataclass(frozen=True, eq=False)
class FloorTile:
    """A marker or board that lies still on the floor, face up: its frame becomes the world.

    Attributes:
        observations: views of it by the cameras of the rig (any number of frames). target: its description.
        patch: its marker id, or 0 for a board.
    """

    observations: CornerObservations
    target: Target
    patch: int
    words: str = "tile on the floor"
    has_floor: bool = True

    def new_from_old(self, rig: Rig) -> SE3:
        """Raises CalibrationError when no camera sees the tile, it moves, or the views disagree."""
        return locate_static(rig, self.observations, self.target, self.patch).inverse()


@dataclass(frozen=True, eq=False)
class ThreePoints:
    """Three marked points on the floor: the origin, one along +X, one on the side of +Y.

    Attributes:
        xy_img: per camera name (3, 2) raw px of the points; NaN where a camera does not see one.
        origin_to_x_m: measured distance of the first two, to check the scale; None checks nothing.
    """

    xy_img: Mapping[str, Array]
    origin_to_x_m: float | None = None
    words: str = "three points on the floor"
    has_floor: bool = True

    def new_from_old(self, rig: Rig) -> SE3:
        """Raises CalibrationError when a point has fewer than 2 views, or the points lie on a line or at another distance."""
        unknown = sorted(set(self.xy_img) - set(rig.names))
        if unknown:
            raise CalibrationError(f"three points: no camera {', '.join(unknown)}; there are: {choices(rig.names)}")
        missing = np.full((3, 2), np.nan)
        xy = np.stack([np.asarray(self.xy_img.get(name, missing), np.float64) for name in rig.names])
        points = triangulate_linear(rig, xy)
        if not np.isfinite(points).all():
            raise CalibrationError("three points: each must be marked in at least 2 cameras")
        length = float(np.linalg.norm(points[1] - points[0]))
        if self.origin_to_x_m is not None and abs(length / self.origin_to_x_m - 1) > 0.02:
            raise CalibrationError(
                f"three points: origin to x measures {length:.3f} m in the rig, {self.origin_to_x_m:.3f} m was given;"
                " a wrong marker side, or a point marked wrongly"
            )
        return frame_from_points(points)


@dataclass(frozen=True, eq=False)
class FloorFromFeet:
    """The plane feet stand on, the origin below the middle of the path, X along the widest extent of the path.

    Attributes:
        feet_m: (N, 3) ankle, heel or toe points in the rig's present world.
        head_m: (M, 3) points of heads, which determine the vertical.
        keypoint_height_m: height of the foot keypoints above the floor while they stand.
    """

    feet_m: Array
    head_m: Array
    keypoint_height_m: float = 0.0
    words: str = "floor under the feet"
    has_floor: bool = True

    def new_from_old(self, rig: Rig) -> SE3:
        """Raises CalibrationError when the feet do not span a plane."""
        return floor_from_feet(self.feet_m, self.head_m, self.keypoint_height_m)


@dataclass(frozen=True, eq=False)
class FloorUnderBody:
    """For feet that stay on one line and so span no plane: up is the way from feet to heads, the floor is below the feet.

    Attributes:
        feet_m, head_m, keypoint_height_m: as in `FloorFromFeet`.
    """

    feet_m: Array
    head_m: Array
    keypoint_height_m: float = 0.0
    words: str = "up along the body, floor under the feet"
    has_floor: bool = True

    def new_from_old(self, rig: Rig) -> SE3:
        """Raises CalibrationError when there are no feet or heads."""
        feet, head = _feet_and_heads(self.feet_m, self.head_m)
        middle = np.median(feet, axis=0)
        up = np.median(head, axis=0) - middle
        up /= np.linalg.norm(up)
        lowest = np.quantile((feet - middle) @ up, _STANDING_SHARE)
        along = np.linalg.svd(feet - middle, full_matrices=False)[2][0]
        return _frame(middle + (lowest - self.keypoint_height_m) * up, along, up)


@dataclass(frozen=True)
class UpFromCameras:
    """No floor known: up is the mean of the images' up directions, the origin is the first camera's place at height 0."""

    words: str = "not set; up guessed from the cameras"
    has_floor: bool = False

    def new_from_old(self, rig: Rig) -> SE3:
        """Always answers."""
        up = -np.mean([camera.cam_from_world.matrix()[1] for camera in rig], axis=0)
        if np.linalg.norm(up) < 1e-3:
            up = -rig.cameras[0].cam_from_world.matrix()[1]
        forward = np.mean([camera.cam_from_world.matrix()[2] for camera in rig], axis=0)
        return _frame(rig.centres_world()[0], forward, up)


def frame_from_points(points: Array) -> SE3:
    """new_from_old with points[0] at the origin, points[1] on +X and points[2] in the plane z = 0 with y > 0."""
    along, aside = points[1] - points[0], points[2] - points[0]
    up = np.cross(along, aside)
    sine = float(np.linalg.norm(up)) / max(float(np.linalg.norm(along) * np.linalg.norm(aside)), 1e-12)
    if sine < np.sin(_LEAST_TRIANGLE_RAD):
        raise CalibrationError("three points: they lie on a line; mark one well to the side of the other two")
    return _frame(points[0], along, up)


def floor_from_feet(feet_m: Array, head_m: Array, keypoint_height_m: float = 0.0) -> SE3:
    """new_from_old of the plane under the lowest foot points: a least-squares plane that drops what is above it.

    Feet in the air lie above the floor, so points far above the plane lose their weight and those below keep it.
    """
    feet, head = _feet_and_heads(feet_m, head_m)
    weight = np.ones(len(feet))
    for _ in range(_FLOOR_ROUNDS):
        middle = weight @ feet / weight.sum()
        _, spread, axes = np.linalg.svd((feet - middle) * np.sqrt(weight)[:, None], full_matrices=False)
        up = axes[2] * np.sign(np.median((head - middle) @ axes[2]))
        height = (feet - middle) @ up
        weight = 1 / (1 + (np.maximum(height, 0.3 * np.minimum(height, 0) * -1) / _FLOOR_CUT_M) ** 2)
    if spread[1] < 0.1 * spread[0]:
        raise CalibrationError("floor: the feet stay on one line; walk across the floor in both directions")
    return _frame(middle - keypoint_height_m * up, axes[0], up)


def _feet_and_heads(feet_m: Array, head_m: Array) -> tuple[Array, Array]:
    """Those that are known; raises CalibrationError when there are too few."""
    feet, head = (points[np.isfinite(points).all(axis=-1)] for points in (feet_m, head_m))
    if len(feet) < 10 or len(head) < 1:
        raise CalibrationError(f"floor: expected at least 10 foot points and 1 head point, got {len(feet)} and {len(head)}")
    return feet, head


def _frame(origin: Array, along: Array, up: Array) -> SE3:
    """new_from_old with z along `up`, x along what is left of `along`."""
    z = up / np.linalg.norm(up)
    x = along - z * (along @ z)
    if np.linalg.norm(x) < 1e-9:
        x = np.cross(z, [0.0, 1.0, 0.0]) if abs(z[1]) < 0.9 else np.cross(z, [1.0, 0.0, 0.0])
    x = x / np.linalg.norm(x)
    new_from_old = np.stack([x, np.cross(z, x), z])
    return SE3.from_matrix(new_from_old, -new_from_old @ origin)


def triangulate_linear(rig: Rig, xy_img: Array) -> Array:
    """(P, 3) points of raw px (C, P, 2), NaN where unseen; see `linear_points`."""
    return linear_points(rig, np.stack([camera.norm_from_px(xy) for camera, xy in zip(rig, xy_img, strict=True)]))


def beside_others(rig: Rig, xy_img: Array) -> Array:
    """(C, P, 2) px from what each camera saw (C, P, 2) to where the rays of the others meet; NaN with fewer than two others."""
    norm = np.stack([camera.norm_from_px(xy) for camera, xy in zip(rig, xy_img, strict=True)])
    apart = np.empty(xy_img.shape)
    for c, camera in enumerate(rig):
        mine = np.arange(len(rig)) == c
        apart[c] = camera.project(linear_points(rig, np.where(mine[:, None, None], np.nan, norm))) - xy_img[c]
    return apart


def linear_points(rig: Rig, norm: Array) -> Array:
    """(P, 3) where the rays of ideal image points (C, P, 2), NaN where unseen, meet: least squares (DLT); NaN below 2 views."""
    count = norm.shape[1]
    rows = np.zeros((count, 2 * len(rig), 4))
    good = np.asarray(np.isfinite(norm).all(axis=2))
    for c, camera in enumerate(rig):
        matrix = camera.cam_from_world.matrix4()[:3]
        rows[good[c], 2 * c : 2 * c + 2] = (norm[c, :, :, None] * matrix[2] - matrix[:2])[good[c]]
    solution = np.linalg.svd(rows)[2][:, -1]
    with np.errstate(divide="ignore", invalid="ignore"):
        points = solution[:, :3] / solution[:, 3:]
    return np.asarray(np.where((good.sum(axis=0) >= 2)[:, None], points, np.nan))
