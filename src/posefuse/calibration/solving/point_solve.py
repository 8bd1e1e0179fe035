"""Bundle adjustment of cameras that watch free points (keypoints of a person at instants)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import Camera
from posefuse.core.arrays import Array

from .bundle import Block, Linearised, Problem, solve
from .projection import Lenses
from .rotations import Poses, hat

_CAUCHY = 2.0
_ROUGH_SIGMA_PX = 8.0
_LEAST_SIGMA_PX = 0.05


@dataclass(frozen=True, eq=False)
class PointViews:
    """Rows of seen points.

    Attributes:
        camera, point: (N,). xy_img: (N, 2) px. point_count: P.
        relative_sigma: (N,) how much noisier a row is than the common spread.
    """

    camera: Array
    point: Array
    xy_img: Array
    point_count: int
    relative_sigma: Array


@dataclass(frozen=True, eq=False)
class PointState:
    """Unknowns: cam_from_world (C,), xyz (P, 3)."""

    cam_from_world: Poses
    xyz: Array


@dataclass(frozen=True, eq=False)
class PointSolution:
    """Where the solve stopped.

    Attributes:
        state: unknowns; the scale is that of the start. sigma_px: robust spread of a coordinate.
        residual_px: (N, 2) predicted minus observed.
    """

    state: PointState
    sigma_px: float
    residual_px: Array


@dataclass(frozen=True)
class PointFreedom:
    """All cameras move except `reference`, and except the translation component `scale` (camera, axis)."""

    reference: int
    scale: tuple[int, int]


def solve_points(views: PointViews, cameras: tuple[Camera, ...], start: PointState, freedom: PointFreedom) -> PointSolution:
    """A robust solve with a wide loss, and one with the spread found."""
    first = solve(_problem(views, cameras, freedom, _ROUGH_SIGMA_PX), start)
    sigma = _spread(first.residual * _ROUGH_SIGMA_PX)
    second = solve(_problem(views, cameras, freedom, sigma), first.state)
    residual = second.residual * sigma
    return PointSolution(second.state, _spread(residual), residual * views.relative_sigma[:, None])


def _spread(residual: Array) -> float:
    good = residual[np.isfinite(residual).all(axis=1)]
    return max(float(1.4826 * np.median(np.abs(good))), _LEAST_SIGMA_PX) if len(good) else _ROUGH_SIGMA_PX


def _problem(views: PointViews, cameras: tuple[Camera, ...], freedom: PointFreedom, sigma_px: float) -> Problem[PointState]:
    lenses, count = Lenses(cameras), len(cameras)
    scale = (sigma_px * views.relative_sigma)[:, None]
    free = np.zeros((count, 6), bool)
    free[np.arange(count) != freedom.reference] = True
    free[freedom.scale[0], 3 + freedom.scale[1]] = False

    def in_cameras(state: PointState) -> Array:
        return state.cam_from_world[views.camera].move(state.xyz[views.point])

    def residual(state: PointState) -> Array:
        return np.asarray((lenses.px(views.camera, in_cameras(state)) - views.xy_img) / scale)

    def linearise(state: PointState) -> Linearised:
        cam = in_cameras(state)
        d_cam = lenses.px_jacobian(views.camera, cam) / scale[..., None]
        turned = cam - state.cam_from_world.t[views.camera]
        pose = np.concatenate([-d_cam @ hat(turned), d_cam], axis=2)
        in_world = d_cam @ state.cam_from_world.R[views.camera]
        return Linearised(residual(state), (Block(pose, views.camera, count),), in_world, views.point)

    def step(state: PointState, blocks: list[Array], local: Array) -> PointState:
        return PointState(state.cam_from_world.stepped(blocks[0]), state.xyz + local)

    return Problem(
        residual=residual, linearise=linearise, step=step, free=(free,), local_count=views.point_count,
        group=np.arange(len(views.camera)), group_count=len(views.camera), cauchy=_CAUCHY,
    )  # fmt: skip
