"""The bundle adjustment of a walking person's keypoints: its start, its rows, and what can be let free."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.extrinsics.world import triangulate_linear
from posefuse.calibration.solving.point_solve import (
    PointFreedom,
    PointSolution,
    PointViews,
    solve_points,
    start_state,
)
from posefuse.calibration.solving.rotations import Poses
from posefuse.core import Camera, Rig
from posefuse.core.arrays import Array

from .checks import LEAST_TRUE_SIDED, true_sided
from .start import first_poses, turned_inside_out
from .views import PersonViews

_MOST_POINTS = 4000
_NEARLY_AS_WELL = 1.5
# stretches of the recording whose errors count as independent
_TIME_BLOCKS = 12


@dataclass(frozen=True, eq=False)
class PersonSolution:
    """The solution of any scale, its rows, and what was free."""

    solution: PointSolution
    rows: PointViews
    freedom: PointFreedom


def solve_person_bundle(views: PersonViews, cameras: tuple[Camera, ...]) -> PersonSolution:
    """The solve; of the two ways to read a body seen from afar, the one in which it is no mirror image."""
    usable = views.usable
    usable &= usable.sum(axis=0) >= 2
    norm = np.stack([camera.norm_from_px(xy) for camera, xy in zip(cameras, views.xy_img, strict=True)])
    usable &= np.isfinite(norm).all(axis=-1)
    poses, (a, b) = first_poses(views.cameras, norm, usable, cameras)
    point_of = np.flatnonzero(usable.any(axis=0).ravel())
    if len(point_of) > _MOST_POINTS:
        # by chance, since every n-th would be the same few keypoints again and again
        point_of = np.sort(np.random.default_rng(0).choice(point_of, _MOST_POINTS, replace=False))
    good, xyz = _start_points(views, cameras, usable, poses, point_of)
    point_of = point_of[good]
    rows = _rows(views, usable, point_of)
    freedom = PointFreedom(a, (b, int(np.argmax(np.abs(poses.t[b] - poses.t[a])))))
    solution = solve_points(rows, cameras, start_state(poses, xyz), freedom)
    if true_sided(views.skeleton, _scattered(views, point_of, solution.state.xyz)) >= LEAST_TRUE_SIDED:
        return PersonSolution(solution, rows, freedom)
    seen = np.where(usable[..., None], norm, np.nan).reshape(len(cameras), -1, 2)[:, point_of]
    focal = np.array([camera.K[0, 0] for camera in cameras])
    other = turned_inside_out(solution.state.cam_from_world, solution.state.xyz, seen, focal, a)
    if other is None:
        return PersonSolution(solution, rows, freedom)
    again = solve_points(rows, cameras, start_state(*other), freedom)
    share = true_sided(views.skeleton, _scattered(views, point_of, again.state.xyz))
    better = share >= LEAST_TRUE_SIDED and again.sigma_px < _NEARLY_AS_WELL * solution.sigma_px
    return PersonSolution(again if better else solution, rows, freedom)


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


def _scattered(views: PersonViews, point_of: Array, xyz: Array) -> Array:
    """(T, K, 3) of solved points; NaN elsewhere."""
    whole = np.full((*views.xy_img.shape[1:3], 3), np.nan)
    whole.reshape(-1, 3)[point_of] = xyz
    return whole


def _rows(views: PersonViews, usable: Array, point_of: Array) -> PointViews:
    """Rows of the chosen points; `point_of` counts in the flattened (T, K)."""
    camera, point = np.nonzero(usable.reshape(len(usable), -1)[:, point_of])
    xy = views.xy_img.reshape(len(usable), -1, 2)[:, point_of][camera, point]
    sigma = views.sigma_px.reshape(len(usable), -1)[:, point_of][camera, point]
    velocity = _velocity_px_s(views).reshape(len(usable), -1, 2)[:, point_of][camera, point]
    return PointViews(
        camera=camera,
        point=point,
        xy_img=xy,
        point_count=len(point_of),
        relative_sigma=sigma / np.median(sigma),
        velocity_px_s=velocity,
        block=point_of // views.xy_img.shape[2] * _TIME_BLOCKS // len(views.t_ns),
    )


def _velocity_px_s(views: PersonViews) -> Array:
    """(C, T, K, 2) of each keypoint in its images, by the frames before and after; 0 where one of them lacks it."""
    out = np.zeros(views.xy_img.shape)
    if len(views.t_ns) > 2:
        apart_s = (views.t_ns[2:] - views.t_ns[:-2]) / 1e9
        out[:, 1:-1] = (views.xy_img[:, 2:] - views.xy_img[:, :-2]) / apart_s[:, None, None]
    return np.nan_to_num(out)


def freed(cameras: tuple[Camera, ...], solved: PersonSolution) -> PointSolution:
    """The solve once more, with every camera's focal length and clock free."""
    freedom = replace(solved.freedom, focal=True, clocks=True)
    return solve_points(solved.rows, cameras, solved.solution.state, freedom)
