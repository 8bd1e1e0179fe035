"""Bundle adjustment of cameras that watch free points (keypoints of a person at instants)."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
        camera, point: (N,). xy_img: (N, 2) px. velocity_px_s: (N, 2). t_s: (N,). point_count: P.
        relative_sigma: (N,) how much noisier a row is than the common spread.
    """

    camera: Array
    point: Array
    xy_img: Array
    velocity_px_s: Array
    t_s: Array
    point_count: int
    relative_sigma: Array


@dataclass(frozen=True, eq=False)
class PointState:
    """Unknowns: cam_from_world (C,), xyz (P, 3), clocks (C,) in s, as in `prop_solve`."""

    cam_from_world: Poses
    xyz: Array
    late_s: Array


@dataclass(frozen=True, eq=False)
class PointSolution:
    """Where the solve stopped.

    Attributes:
        state: unknowns; the scale is that of the start. sigma_px: robust spread of a coordinate.
        residual_px: (N, 2). weight: (N,) robust. camera_covariance: (C, 6, 6). late_sigma_s: (C,).
    """

    state: PointState
    sigma_px: float
    residual_px: Array
    weight: Array
    camera_covariance: Array
    late_sigma_s: Array


@dataclass(frozen=True)
class PointFreedom:
    """What moves: cameras except `reference` (all held when None), one translation component of `scale`, clocks."""

    reference: int | None
    scale: tuple[int, int] | None
    clocks: bool = False


def solve_points(views: PointViews, cameras: tuple[Camera, ...], start: PointState, freedom: PointFreedom) -> PointSolution:
    """A robust solve with a wide loss, and one with the spread found."""
    first = solve(_problem(views, cameras, start, freedom, _ROUGH_SIGMA_PX), start)
    sigma = _spread(first.residual * _ROUGH_SIGMA_PX)
    second = solve(_problem(views, cameras, first.state, freedom, sigma), first.state)
    residual = second.residual * sigma
    found = _spread(residual)
    free = np.concatenate([mask.ravel() for mask in _free(len(cameras), freedom)])
    full = np.zeros((len(free), len(free)))
    full[np.ix_(free, free)] = second.covariance * (found / sigma) ** 2
    count = len(cameras)
    poses = np.stack([full[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i in range(count)])
    late = np.sqrt(np.diag(full)[6 * count :]) * _CLOCK_SCALE_S
    return PointSolution(second.state, found, residual * views.relative_sigma[:, None], second.weight, poses, late)


_CLOCK_SCALE_S = 1e-3


def _spread(residual: Array) -> float:
    good = residual[np.isfinite(residual).all(axis=1)]
    return max(float(1.4826 * np.median(np.abs(good))), _LEAST_SIGMA_PX) if len(good) else _ROUGH_SIGMA_PX


def _free(count: int, freedom: PointFreedom) -> tuple[Array, Array]:
    cameras, clocks = np.zeros((count, 6), bool), np.zeros((count, 1), bool)
    if freedom.reference is not None:
        cameras[np.arange(count) != freedom.reference] = True
    if freedom.clocks:
        clocks[np.arange(count) != (freedom.reference or 0)] = True
    if freedom.scale is not None:
        cameras[freedom.scale[0], 3 + freedom.scale[1]] = False
    return cameras, clocks


def _problem(
    views: PointViews, cameras: tuple[Camera, ...], start: PointState, freedom: PointFreedom, sigma_px: float
) -> Problem[PointState]:
    lenses = Lenses(cameras)
    scale = (sigma_px * views.relative_sigma)[:, None]
    count = len(cameras)

    def predict(state: PointState) -> tuple[Array, Array, Array]:
        cam = state.cam_from_world[views.camera].move(state.xyz[views.point])
        px, jacobian = lenses.project(views.camera, cam)
        late = (state.late_s - start.late_s)[views.camera][:, None]
        return (px - views.xy_img - views.velocity_px_s * late) / scale, jacobian / scale[..., None], cam

    def linearise(state: PointState) -> Linearised:
        residual, d_cam, cam = predict(state)
        turned = cam - state.cam_from_world.t[views.camera]
        pose = np.concatenate([-d_cam @ hat(turned), d_cam], axis=2)
        clock = (-views.velocity_px_s / scale * _CLOCK_SCALE_S)[..., None]
        blocks = (Block(pose, views.camera, count), Block(clock, views.camera, count))
        return Linearised(residual, blocks, d_cam @ state.cam_from_world.R[views.camera], views.point)

    def step(state: PointState, blocks: list[Array], local: Array) -> PointState:
        return replace(
            state,
            cam_from_world=state.cam_from_world.stepped(blocks[0]),
            xyz=state.xyz + local,
            late_s=state.late_s + blocks[1][:, 0] * _CLOCK_SCALE_S,
        )

    return Problem(
        lambda state: predict(state)[0], linearise, step, _free(count, freedom), views.point_count,
        np.arange(len(views.camera)), len(views.camera), _CAUCHY,
    )  # fmt: skip
