"""The bundle adjustment of a walking person's keypoints: its start, its rows, and what can be let free."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.extrinsics.world import triangulate_linear
from posefuse.calibration.solving.point_solve import PointFreedom, PointSolution, PointState, PointViews, solve_points
from posefuse.calibration.solving.rotations import Poses
from posefuse.core import Camera, Rig
from posefuse.core.arrays import Array

from .start import first_poses
from .views import PersonViews

MOST_POINTS = 4000
# stretches of the recording whose errors count as independent
_TIME_BLOCKS = 12
# speeds are read over so long before and after
_SPEED_S = 0.1


@dataclass(frozen=True, eq=False)
class PersonSolution:
    """The solution of any scale, its rows, and what was free."""

    solution: PointSolution
    rows: PointViews
    freedom: PointFreedom


def solve_person_bundle(
    views: PersonViews, cameras: tuple[Camera, ...], most_points: int = MOST_POINTS, near: PersonSolution | None = None
) -> PersonSolution:
    """Poses of the cameras and places of the keypoints, from nothing or from a solution that is `near`."""
    usable = views.usable
    usable &= usable.sum(axis=0) >= 2
    norm = np.stack([camera.norm_from_px(xy) for camera, xy in zip(cameras, views.xy_img, strict=True)])
    usable &= np.isfinite(norm).all(axis=-1)
    if near is None:
        poses, (a, b) = first_poses(views.cameras, norm, usable, cameras)
        freedom = PointFreedom(a, (b, int(np.argmax(np.abs(poses.t[b] - poses.t[a])))))
    else:
        poses, freedom = near.solution.state.cam_from_world, near.freedom
    point_of = np.flatnonzero(usable.any(axis=0).ravel())
    if len(point_of) > most_points:
        # by chance, since every n-th would be the same few keypoints again and again
        point_of = np.sort(np.random.default_rng(0).choice(point_of, most_points, replace=False))
    good, xyz = _start_points(views, cameras, usable, poses, point_of)
    point_of = point_of[good]
    rows = _rows(views, usable, point_of)
    start = PointState(poses, xyz, np.zeros((len(cameras), 3)))
    return PersonSolution(solve_points(rows, cameras, start, freedom), rows, freedom)


def _start_points(
    views: PersonViews, cameras: tuple[Camera, ...], usable: Array, poses: Poses, point_of: Array
) -> tuple[Array, Array]:
    """Which of the points (P,) the first poses place in front of all that see them, and where (n, 3)."""
    rig = Rig(tuple(replace(c, cam_from_world=poses[i].se3()) for i, c in enumerate(cameras)))
    xy = np.where(usable[..., None], views.xy_img, np.nan).reshape(len(cameras), -1, 2)[:, point_of]
    xyz = triangulate_linear(rig, xy)
    in_front = np.stack([(camera.cam_from_world @ xyz)[:, 2] > 0.05 for camera in rig])
    good = np.asarray(np.isfinite(xyz).all(axis=1) & (in_front | ~np.isfinite(xy).all(axis=-1)).all(axis=0))
    return good, xyz[good]


def _rows(views: PersonViews, usable: Array, point_of: Array) -> PointViews:
    """Rows of the chosen points; `point_of` counts in the flattened (T, K)."""
    camera, point = np.nonzero(usable.reshape(len(usable), -1)[:, point_of])
    xy = views.xy_img.reshape(len(usable), -1, 2)[:, point_of][camera, point]
    sigma = views.sigma_px.reshape(len(usable), -1)[:, point_of][camera, point]
    velocity = _velocity_px_s(views).reshape(len(usable), -1, 2)[:, point_of][camera, point]
    step = point_of // views.xy_img.shape[2]
    since_s = (views.t_ns - views.t_ns[[0, -1]].mean()) / 1e9
    return PointViews(
        camera=camera,
        point=point,
        xy_img=xy,
        point_count=len(point_of),
        relative_sigma=sigma / np.median(sigma),
        velocity_px_s=velocity,
        since_s=since_s[step][point],
        block=step * _TIME_BLOCKS // len(views.t_ns),
    )


def _velocity_px_s(views: PersonViews) -> Array:
    """(C, T, K, 2) of each keypoint in its images, by frames before and after; 0 where one of them lacks it."""
    out, steps = np.zeros(views.xy_img.shape), len(views.t_ns)
    lag = max(1, round(_SPEED_S * 1e9 / float(np.median(np.diff(views.t_ns))))) if steps > 1 else 1
    if steps > 2 * lag:
        apart_s = (views.t_ns[2 * lag :] - views.t_ns[: -2 * lag]) / 1e9
        out[:, lag:-lag] = (views.xy_img[:, 2 * lag :] - views.xy_img[:, : -2 * lag]) / apart_s[:, None, None]
    return np.nan_to_num(out)


def freed(cameras: tuple[Camera, ...], solved: PersonSolution, *, focal: bool = False, drift: bool = False) -> PointSolution:
    """The solve once more, with every camera's clock free, and on request its focal length and the rate of its clock."""
    freedom = replace(solved.freedom, clocks=True, focal=focal, drift=drift)
    return solve_points(solved.rows, cameras, solved.solution.state, freedom)
