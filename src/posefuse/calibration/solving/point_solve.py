"""Bundle adjustment of cameras that watch free points (keypoints of a person at time steps)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import Camera
from posefuse.core.arrays import Array

from .bundle import Linearised, Problem, ResidualBlock, Solution, clustered_covariance, solve_bundle
from .projection import Lenses
from .rotations import Poses, hat

_CAUCHY = 2.0
_ROUGH_SIGMA_PX = 8.0
_LEAST_SIGMA_PX = 0.05
# what is known of a camera's focal length (share), clock (s) and clock rate before they are let free
_TERM_SIGMA = np.array([0.5, 0.5, 3e-3])
FOCAL, LATE, DRIFT = 0, 1, 2


@dataclass(frozen=True, eq=False)
class PointViews:
    """Rows of seen points.

    Attributes:
        camera, point: (N,). xy_img: (N, 2) px. point_count: P.
        relative_sigma: (N,) how much noisier a row is than the common spread.
        velocity_px_s: (N, 2) of the seen points, and since_s: (N,) time from the middle of the recording, needed where clocks are
            let free. block: (P,) number of the stretch of time of each point: errors within one are not independent.
    """

    camera: Array
    point: Array
    xy_img: Array
    point_count: int
    relative_sigma: Array
    velocity_px_s: Array
    since_s: Array
    block: Array


@dataclass(frozen=True, eq=False)
class PointState:
    """Unknowns.

    Attributes:
        cam_from_world: (C,). xyz: (P, 3). terms: (C, 3): focal lengths longer by a share, clocks late by s, clocks
            fast by a share.
    """

    cam_from_world: Poses
    xyz: Array
    terms: Array


@dataclass(frozen=True, eq=False)
class PointSolution:
    """Where the solve stopped.

    Attributes:
        state: unknowns; the scale is that of the start. sigma_px: robust spread of a coordinate.
        residual_px: (N, 2) predicted minus observed. terms_sigma: (C, 3) standard errors; 0 where held.
    """

    state: PointState
    sigma_px: float
    residual_px: Array
    terms_sigma: Array


@dataclass(frozen=True)
class PointFreedom:
    """All cameras move except `reference`, and except the translation component `scale` (camera, axis).

    Attributes:
        focal: let every focal length free. clocks: and every clock but the reference's. drift: and its rate.
    """

    reference: int
    scale: tuple[int, int]
    focal: bool = False
    clocks: bool = False
    drift: bool = False


def solve_points(views: PointViews, cameras: tuple[Camera, ...], start: PointState, freedom: PointFreedom) -> PointSolution:
    """A robust solve with a wide loss, and one with the spread found."""
    first = solve_bundle(_problem(views, cameras, freedom, _ROUGH_SIGMA_PX), start)
    sigma = first.spread_px(_ROUGH_SIGMA_PX, _LEAST_SIGMA_PX)
    second = solve_bundle(_problem(views, cameras, freedom, sigma), first.state)
    found = second.spread_px(sigma, _LEAST_SIGMA_PX)
    terms_sigma = _terms_sigma(second, views, freedom, (found / sigma) ** 2)
    return PointSolution(second.state, found, second.residual * sigma * views.relative_sigma[:, None], terms_sigma)


def _free(count: int, freedom: PointFreedom) -> tuple[Array, Array]:
    poses, terms = np.zeros((count, 6), bool), np.zeros((count, len(_TERM_SIGMA)), bool)
    others = np.arange(count) != freedom.reference
    poses[others] = True
    poses[freedom.scale[0], 3 + freedom.scale[1]] = False
    terms[:, FOCAL] = freedom.focal
    terms[:, LATE] = others & freedom.clocks
    terms[:, DRIFT] = others & freedom.drift
    return poses, terms


def _terms_sigma(solution: Solution[PointState], views: PointViews, freedom: PointFreedom, scale: float) -> Array:
    poses, terms = _free(len(solution.state.terms), freedom)
    sigma = np.zeros(terms.shape)
    if terms.any():
        covariance = clustered_covariance(solution.covariance * scale, solution.scores / scale, views.block)
        sigma[terms] = np.sqrt(np.diag(covariance)[np.count_nonzero(poses) :])
    return sigma


def _problem(views: PointViews, cameras: tuple[Camera, ...], freedom: PointFreedom, sigma_px: float) -> Problem[PointState]:
    lenses, count = Lenses(cameras), len(cameras)
    scale = (sigma_px * views.relative_sigma)[:, None]
    centre = np.stack([camera.K[:2, 2] for camera in cameras])[views.camera]
    prior = np.broadcast_to(1 / _TERM_SIGMA**2, (count, len(_TERM_SIGMA)))

    def in_cameras(state: PointState) -> Array:
        return state.cam_from_world[views.camera].move(state.xyz[views.point])

    def residual(state: PointState) -> Array:
        longer, late_s, drift = state.terms[views.camera].T
        away = lenses.px(views.camera, in_cameras(state)) - centre
        # a frame stamped late shows an earlier moment
        predicted = centre + away * (1 + longer)[:, None] - views.velocity_px_s * (late_s + drift * views.since_s)[:, None]
        return np.asarray((predicted - views.xy_img) / scale)

    def linearise(state: PointState) -> Linearised:
        cam = in_cameras(state)
        longer = (1 + state.terms[views.camera, FOCAL])[:, None, None]
        d_cam = lenses.px_jacobian(views.camera, cam) * longer / scale[..., None]
        turned = cam - state.cam_from_world.t[views.camera]
        pose = np.concatenate([-d_cam @ hat(turned), d_cam], axis=2)
        in_world = d_cam @ state.cam_from_world.R[views.camera]
        away = lenses.px(views.camera, cam) - centre
        late = -views.velocity_px_s
        terms = np.stack([away, late, late * views.since_s[:, None]], axis=2) / scale[..., None]
        blocks = (ResidualBlock(pose, views.camera, count), ResidualBlock(terms, views.camera, count, prior, state.terms))
        return Linearised(residual(state), blocks, in_world, views.point)

    def step(state: PointState, blocks: list[Array], local: Array) -> PointState:
        return PointState(state.cam_from_world.stepped(blocks[0]), state.xyz + local, state.terms + blocks[1])

    return Problem(
        residual=residual, linearise=linearise, step=step, free=_free(count, freedom), local_count=views.point_count,
        group=np.arange(len(views.camera)), group_count=len(views.camera), cauchy=_CAUCHY,
        prior_cost=lambda state: float((prior * state.terms**2).sum()),
    )  # fmt: skip
