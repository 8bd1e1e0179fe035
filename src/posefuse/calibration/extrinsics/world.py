"""The world frame: Z up, metres, from a tile on the floor, or from feet on the floor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.geometry import Lenses, Poses, poses_of
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Markers, Target, patch_corners
from posefuse.core import SE3, CalibrationError, Camera, InputError, Rig
from posefuse.core.arrays import Array

from .bootstrap import PropShape, prop_path
from .prop_solve import Freedom, PropState, SolvedRig, solve_prop
from .snapshots import Snapshots, snapshots

_MOST_STILL_PX = 3.0
_MOST_STATIC_RMS_PX_PER_1000 = 4.0


def aligned(observations: CornerObservations, rig: Rig) -> CornerObservations:
    """Observations with the rig's cameras in the rig's order; raises CalibrationError for one the rig does not have."""
    unknown = [name for name in observations.cameras if name not in rig.names]
    if unknown:
        raise CalibrationError(
            f"observations of {', '.join(unknown)}: no such camera in the rig; there are: {', '.join(rig.names)}"
        )
    for name, size in zip(observations.cameras, observations.sizes_wh, strict=True):
        if tuple(size) != rig[name].size_wh:
            raise CalibrationError(
                f"camera {name}: images are {size[0]}x{size[1]} px, its calibration {rig[name].size_wh}, in other proportions:"
                " calibrate its intrinsics from images as these are"
            )
    place = np.array([rig.names.index(name) for name in observations.cameras], dtype=np.int64)
    frames = dict(zip(observations.cameras, observations.frame_count, strict=True))
    return replace(
        observations,
        cameras=rig.names,
        sizes_wh=tuple(camera.size_wh for camera in rig),
        frame_count=tuple(frames.get(name, 0) for name in rig.names),
        camera=place[observations.camera] if len(observations) else observations.camera,
    )


def locate_static(rig: Rig, observations: CornerObservations, target: Target, patch: int) -> SE3:
    """world_from_patch of a patch that lies still, from all frames of all cameras that see it.

    Raises:
        CalibrationError: no camera sees it, it moved, or the cameras disagree about where it is.
    """
    mine = aligned(observations, rig).of_patches([patch])
    if len(mine) == 0:
        raise CalibrationError(f"target {patch}: no camera sees it; seen are: {sorted(set(observations.patch.tolist()))}")
    still = _one_frame(mine, patch)
    seen = snapshots(still, np.zeros(1, np.int64), np.zeros((len(rig), 2)))
    placed = placed_by_rig(rig, seen, seen, target, Freedom(reference=None, held_patches=None))
    if placed is None:
        raise CalibrationError(f"target {patch}: no camera sees 4 of its corners")
    width = max(max(camera.size_wh) for camera in rig)
    rms = float(np.sqrt((placed.solution.residual_px**2).mean()))
    limit = _MOST_STATIC_RMS_PX_PER_1000 * width / 1000
    if not rms <= limit:
        raise CalibrationError(
            f"target {patch}: cameras disagree about where it lies, {rms:.1f} px (limit {limit:.1f});"
            " was it moved, is its side right, did a camera move?"
        )
    return placed.solution.state.world_from_prop.se3()[0]


def _one_frame(mine: CornerObservations, patch: int) -> CornerObservations:
    """The median place of every corner in every camera, as one frame at time 0."""
    key = np.stack([mine.camera, mine.corner], axis=1)
    pairs, place = np.unique(key, axis=0, return_inverse=True)
    place = place.ravel()
    middle = np.stack([np.median(mine.xy_img[place == i], axis=0) for i in range(len(pairs))])
    off = np.abs(mine.xy_img - middle[place]).max(axis=1)
    loose = float(np.median(off))
    if loose > _MOST_STILL_PX:
        raise CalibrationError(f"target {patch}: it moves in the images (by {loose:.0f} px); lay it down still")
    n = len(pairs)
    return replace(
        mine, camera=pairs[:, 0], corner=pairs[:, 1], t_ns=np.zeros(n, np.int64), patch=np.full(n, patch), xy_img=middle
    )


def placed_by_rig(rig: Rig, seen: Snapshots, placing: Snapshots, target: Target, freedom: Freedom) -> SolvedRig | None:
    """A solve from the cameras and clocks of the rig, for one patch of the target at every time step.

    Args:
        placing: those of the corners that show where the patch is.

    Returns:
        The solution, of the time steps at which the patch has a place; None where no camera sees enough of it.
    """
    shape, corners = PropShape({0: Poses(np.eye(3), np.zeros(3))}, (0,)), patch_corners(target, seen.patches)
    track = prop_path(placing, shape, corners, Lenses(tuple(rig)), poses_of(rig))
    known = np.asarray(np.isfinite(track.t).all(axis=1))
    if not known.any():
        return None
    seen = seen.rows(known[seen.time_step])
    start = PropState.starting(poses_of(rig), track, Poses.identity(1), np.zeros((len(rig), 2)))
    solution = solve_prop(seen, corners, tuple(rig), start, freedom)
    return SolvedRig(cameras=tuple(rig), seen=seen, corners=corners, solution=solution, freedom=freedom)


_FLOOR_CUT_M = 0.04
_FLOOR_ROUNDS = 20
# of the foot points of a person who walks so many are on the floor
_STANDING_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class WorldRule:
    """How the world frame comes about.

    Attributes:
        words: for `Rig.world_set_by`. has_floor: whether z = 0 is the floor.
        new_from_old: the motion that takes a rig's present world to the wanted one; raises CalibrationError where there is none.
    """

    words: str
    has_floor: bool
    new_from_old: Callable[[Rig], SE3]


def floor_tile(observations: CornerObservations, target: Target, patch: int) -> WorldRule:
    """A marker or board that lies still on the floor, face up: its frame becomes the world.

    Args:
        observations: views of it by the cameras of the rig (any number of frames). target: its description.
        patch: its marker id, or 0 for a board.
    """
    return WorldRule("tile on the floor", True, lambda rig: locate_static(rig, observations, target, patch).inverse())


def floor_under_body(feet_m: Array, head_m: Array, keypoint_height_m: float = 0.0) -> SE3:
    """For feet that stay on one line and so span no plane: up is the way from feet to heads, the floor is below the feet.

    Raises:
        CalibrationError: there are no feet or heads.
    """
    feet, head = _feet_and_heads(feet_m, head_m)
    middle = np.median(feet, axis=0)
    up = np.median(head, axis=0) - middle
    up /= np.linalg.norm(up)
    lowest = np.quantile((feet - middle) @ up, _STANDING_SHARE)
    along = np.linalg.svd(feet - middle, full_matrices=False)[2][0]
    return _frame(middle + (lowest - keypoint_height_m) * up, along, up)


def up_from_cameras(rig: Rig) -> SE3:
    """No floor known: up is the mean of the images' up directions, the origin is the first camera's place at height 0."""
    up = -np.mean([camera.cam_from_world.matrix()[1] for camera in rig], axis=0)
    if np.linalg.norm(up) < 1e-3:
        up = -rig.cameras[0].cam_from_world.matrix()[1]
    forward = np.mean([camera.cam_from_world.matrix()[2] for camera in rig], axis=0)
    return _frame(rig.centres_world()[0], forward, up)


UP_FROM_CAMERAS = WorldRule("not set; up guessed from the cameras", False, up_from_cameras)


def floor_from_feet(feet_m: Array, head_m: Array, keypoint_height_m: float = 0.0) -> SE3:
    """new_from_old of the plane under the lowest foot points: a least-squares plane that drops what is above it.

    The origin is below the middle of the path, X along its widest extent. `feet_m` (N, 3): ankles, heels or toes; `head_m` (M, 3)
    determine the vertical; `keypoint_height_m`: of foot keypoints above the floor while they stand.
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


# a board that gives the focal length to a per cent gives k1 and k2 to about this
_LENS_PER_PERCENT = 0.02


def check_floor(marker: int | None, target: Target) -> None:
    """Raise InputError where the floor needs another target, ConfigError where the dictionary has no such marker."""
    if marker is not None:
        if not isinstance(target, Markers):
            raise InputError("a marker on the floor needs a target of markers, of the same dictionary")
        _tile(marker, target)


def with_floor(target: Target, marker: int | None) -> Target:
    """What to look for in the images: the target, and the marker on the floor where the target has markers of its own only."""
    if marker is not None and isinstance(target, Markers) and target.ids and marker not in target.ids:
        return replace(target, ids=(*target.ids, marker))
    return target


def moved_target(target: Target, marker: int | None) -> Target:
    """What of a target is moved: its markers without the one on the floor."""
    return replace(target, ids=tuple(one for one in target.ids if one != marker)) if isinstance(target, Markers) else target


def world_rule(
    marker: int | None, observations: CornerObservations, target: Target
) -> tuple[CornerObservations, WorldRule | None]:
    """The observations of the moving target alone, and what sets the world; None estimates up from the cameras."""
    if marker is None or not isinstance(target, Markers):
        return observations, None
    world = floor_tile(observations.of_patches([marker]), _tile(marker, target), marker)
    return observations.rows(observations.patch != marker), world


def _tile(marker: int, target: Markers) -> Markers:
    return replace(target, ids=(marker,))


def lens_sigma(percent: float | None, cameras: Sequence[Camera]) -> tuple[float, ...] | None:
    """Standard errors of fx, fy, cx, cy (px), k1, k2 for intrinsics whose focal length is known to `percent`; None keeps them.

    Raises:
        InputError: a percentage that is not above 0.
    """
    if percent is None:
        return None
    if not percent > 0:
        raise InputError(f"`focal_known_to_percent={percent:g}`: expected > 0 percent, got {percent:g}")
    focal_px = percent / 100 * float(np.mean([camera.K[0, 0] for camera in cameras]))
    return (focal_px,) * 4 + (_LENS_PER_PERCENT * percent,) * 2
