"""Bundle adjustment of cameras that watch moving rigid props (after Sarmadi et al. 2019, section 3.4).

Unknown: the pose of every patch (marker) on the prop, of the prop at every time step, of every camera; on request each
camera's clock (offset and drift) and lens. Held: the first camera at the origin and one patch on each prop.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.bundle import Linearised, Problem, ResidualBlock, Solution, clustered_covariance, solve_bundle
from posefuse.calibration.geometry import LENS_PARAMETERS, Lenses, Poses, hat
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .snapshots import Snapshots

_ROUGH_SIGMA_PX, _LEAST_SIGMA_PX = 2.0, 0.05
_CAUCHY = 3.0
_DELAY_SCALE_S = np.array([1e-3, 1e-5])
_TURN_SCALE_RAD_S = 1e-3
# stretches of a recording whose scatter the standard errors answer for
_TIME_BLOCKS = 16


@dataclass(frozen=True, eq=False)
class PropState:
    """All unknowns.

    Attributes:
        cam_from_world: (C,). world_from_prop: (T,), each of one prop. prop_from_patch: (M,).
        delay_s: (C, 2) clock offset in s and drift in s/s, as in `snapshots`.
        lens_delta: (C, 6) correction of `LENS_PARAMETERS`.
        turn_rad_s: (C, 3) rate at which a camera turns about its own axes; the pose is that of the middle of the recording.
    """

    cam_from_world: Poses
    world_from_prop: Poses
    prop_from_patch: Poses
    delay_s: Array
    lens_delta: Array
    turn_rad_s: Array

    @classmethod
    def starting(cls, cam_from_world: Poses, track: Poses, prop_from_patch: Poses, delay_s: Array) -> PropState:
        """Where a solve starts: the prop along its `track`, NaN where that is unknown, intrinsics as given, no camera turning."""
        count, world_from_prop = len(cam_from_world), Poses(track.R, np.nan_to_num(track.t))
        nothing = np.zeros((count, len(LENS_PARAMETERS))), np.zeros((count, 3))
        return cls(cam_from_world, world_from_prop, prop_from_patch, delay_s, *nothing)


@dataclass(frozen=True, eq=False, kw_only=True)
class Freedom:
    """What may move besides the poses.

    Attributes:
        reference: camera whose pose and clock are held; None holds all cameras.
        held_patches: patches that are held on their prop; None holds all.
        offset, drift: clocks of the other cameras.
        lens_sigma: (6,) standard errors of the given intrinsics, 0 holds one of them, None holds all.
        lens_of: cameras whose intrinsics move, None for all.
        moving: cameras whose poses and clocks move, instead of all but the reference.
        turning: cameras that may turn at a constant rate; as all places stay, the reference camera's is determined, too.
    """

    reference: int | None
    held_patches: tuple[int, ...] | None
    offset: bool = False
    drift: bool = False
    lens_sigma: Array | None = None
    lens_of: tuple[int, ...] | None = None
    moving: tuple[int, ...] | None = None
    turning: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class PropSolution:
    """Where the solve stopped.

    Attributes:
        state: unknowns. sigma_px: robust spread of a corner coordinate.
        residual_px: (N, 2) predicted minus observed.
        camera_covariance: (C, 6, 6) of rotation vector (rad) and translation (m) of cam_from_world, relative to the reference;
            like all standard errors here at least the scatter between parts of the recording.
        delay_sigma_s: (C, 2) standard errors of the clocks; 0 where held.
        lens_covariance: (C, 6, 6) of `LENS_PARAMETERS`; 0 where held.
        turn_covariance: (C, 3, 3) of `turn_rad_s`; 0 where held.
        predicted_sigma_px: (N,) standard error of where the camera as found sees a point, by its pose, clock and intrinsics.
    """

    state: PropState
    sigma_px: float
    residual_px: Array
    camera_covariance: Array
    delay_sigma_s: Array
    lens_covariance: Array
    turn_covariance: Array
    predicted_sigma_px: Array


def solve_prop(seen: Snapshots, corners: Array, cameras: tuple[Camera, ...], start: PropState, freedom: Freedom) -> PropSolution:
    """Two robust solves: one with a wide loss to come near, one with the noise found by the first.

    `corners` (M, n, 3): corners of each patch in its own frame. `start.delay_s` is the delay the snapshots were taken
    with; the clock columns move them along their image velocity from there.
    """
    given = (seen, corners, cameras, start, freedom)
    first = solve_bundle(_PropProblem(*given, sigma_px=_ROUGH_SIGMA_PX, cauchy=1.0), start)
    sigma_px = first.spread_px(_ROUGH_SIGMA_PX, _LEAST_SIGMA_PX)
    second = solve_bundle(_PropProblem(*given, sigma_px=sigma_px, cauchy=_CAUCHY), first.state)
    return _summary(second, sigma_px, freedom, seen)


def residuals_px(seen: Snapshots, corners: Array, cameras: tuple[Camera, ...], state: PropState) -> Array:
    """(N, 2) predicted minus observed px of corners that were read at the clocks of the state; arguments as of `solve_prop`."""
    held = Freedom(reference=None, held_patches=None)
    return _PropProblem(seen, corners, cameras, state, held, sigma_px=1.0, cauchy=1.0).residual(state)


def _summary(solution: Solution[PropState], assumed_px: float, freedom: Freedom, seen: Snapshots) -> PropSolution:
    """Standard errors by the noise that was found instead of the noise that was assumed."""
    residual_px = solution.residual * assumed_px
    sigma_px = solution.spread_px(assumed_px, _LEAST_SIGMA_PX)
    scale = (sigma_px / assumed_px) ** 2
    count = len(solution.state.cam_from_world)
    free = np.concatenate([mask.ravel() for mask in _free(solution.state, freedom)])
    full = np.zeros((len(free), len(free)))
    covariance = clustered_covariance(solution.covariance * scale, solution.scores / scale, _time_block(seen.t_s))
    full[np.ix_(free, free)] = covariance
    # pose, clock and intrinsics of each camera
    clocks = 6 * count + 6 * len(solution.state.prop_from_patch)
    begins = ((0, 6), (clocks, 2), (clocks + 2 * count, len(LENS_PARAMETERS)), (clocks + 8 * count, 3))
    own = [np.concatenate([begin + size * i + np.arange(size) for begin, size in begins]) for i in range(count)]
    joint = np.stack([full[np.ix_(one, one)] for one in own])
    poses, _, *others = (block.jacobian * assumed_px for block in solution.linear.blocks)
    slope, predicted_px2 = np.concatenate([poses, *others], axis=2), np.zeros(len(residual_px))
    for i in range(count):
        mine = slope[seen.camera == i]
        predicted_px2[seen.camera == i] = np.einsum("nai,ij,naj->n", mine, joint[i], mine)
    return PropSolution(
        state=solution.state,
        sigma_px=sigma_px,
        residual_px=residual_px,
        camera_covariance=joint[:, :6, :6],
        delay_sigma_s=np.sqrt(np.diagonal(joint[:, 6:8, 6:8], axis1=1, axis2=2)) * _DELAY_SCALE_S,
        lens_covariance=joint[:, 8:14, 8:14],
        turn_covariance=joint[:, 14:, 14:] * _TURN_SCALE_RAD_S**2,
        predicted_sigma_px=np.sqrt(np.maximum(predicted_px2, 0.0)),
    )


def _time_block(t_s: Array) -> Array:
    """(T,) number of the stretch of time each time step belongs to."""
    first, last = (float(t_s.min()), float(t_s.max())) if len(t_s) else (0.0, 0.0)
    return np.minimum(((t_s - first) / max(last - first, 1e-9) * _TIME_BLOCKS).astype(np.int64), _TIME_BLOCKS - 1)


def _free(state: PropState, freedom: Freedom) -> tuple[Array, ...]:
    cameras, clocks, turns = (np.zeros((len(state.cam_from_world), n), bool) for n in (6, 2, 3))
    patches = np.zeros((len(state.prop_from_patch), 6), bool)
    if freedom.moving is not None or freedom.reference is not None:
        others = np.arange(len(cameras)) != freedom.reference
        if freedom.moving is not None:
            others = np.isin(np.arange(len(cameras)), freedom.moving)
        cameras[others], clocks[others] = True, (freedom.offset, freedom.drift)
    if freedom.held_patches is not None:
        patches[~np.isin(np.arange(len(patches)), freedom.held_patches)] = True
    lens = np.zeros((len(cameras), len(LENS_PARAMETERS)), bool)
    if freedom.lens_sigma is not None:
        lens[:] = freedom.lens_sigma > 0
    if freedom.lens_of is not None:
        lens &= np.isin(np.arange(len(cameras)), freedom.lens_of)[:, None]
    turns[list(freedom.turning)] = True
    return cameras, patches, clocks, lens, turns


class _PropProblem(Problem[PropState]):
    """Residuals and Jacobians of the corners."""

    def __init__(
        self, seen: Snapshots, corners: Array, cameras: tuple[Camera, ...], start: PropState, freedom: Freedom, *,
        sigma_px: float, cauchy: float,
    ) -> None:  # fmt: skip
        self._seen, self._cameras, self._freedom, self._sigma_px = seen, cameras, freedom, sigma_px
        self.free, self.local_count, self.cauchy = _free(start, freedom), len(start.world_from_prop), cauchy
        self.group, self.group_count = seen.group, seen.group_count
        self._xyz_patch = corners[seen.patch, seen.corner]
        self._delay_s = start.delay_s
        lens_sigma = np.zeros(len(LENS_PARAMETERS)) if freedom.lens_sigma is None else freedom.lens_sigma
        self._lens_prior = np.divide(1.0, lens_sigma**2, out=np.zeros(len(LENS_PARAMETERS)), where=lens_sigma > 0)

    def residual(self, state: PropState) -> Array:
        seen, (_, _, cam, lenses) = self._seen, self._placed(state)
        late = (state.delay_s - self._delay_s)[seen.camera]
        late_s = late[:, 0] + late[:, 1] * seen.t_s[seen.time_step]
        return np.asarray((lenses.px(seen.camera, cam) - seen.xy_img - seen.velocity_px_s * late_s[:, None]) / self._sigma_px)

    def prior_cost(self, state: PropState) -> float:
        return float((self._lens_prior * state.lens_delta**2).sum())

    def step(self, state: PropState, blocks: list[Array], local: Array) -> PropState:
        camera, patch, clock, lens, turn = blocks
        return replace(
            state,
            cam_from_world=state.cam_from_world.stepped(camera),
            prop_from_patch=state.prop_from_patch.stepped(patch),
            delay_s=state.delay_s + clock * _DELAY_SCALE_S,
            lens_delta=state.lens_delta + lens,
            turn_rad_s=state.turn_rad_s + turn * _TURN_SCALE_RAD_S,
            world_from_prop=state.world_from_prop.stepped(local),
        )

    def _placed(self, state: PropState) -> tuple[Array, Array, Array, Lenses]:
        """The corners (N, 3) in axes of the prop, of the world and of the camera that sees them; and the lenses."""
        seen = self._seen
        prop = state.prop_from_patch[seen.patch].move(self._xyz_patch)
        world = state.world_from_prop[seen.time_step].move(prop)
        cam = state.cam_from_world[seen.camera].move(world)
        if state.turn_rad_s.any():
            cam = cam + np.cross(state.turn_rad_s[seen.camera] * seen.t_s[seen.time_step][:, None], cam)
        return prop, world, cam, Lenses(self._cameras, state.lens_delta)

    def linearise(self, state: PropState) -> Linearised:
        seen = self._seen
        prop, world, cam, lenses = self._placed(state)
        d_cam = lenses.px_jacobian(seen.camera, cam) / self._sigma_px
        R_cam = state.cam_from_world.R[seen.camera]
        R_prop = state.world_from_prop.R[seen.time_step]
        d_world = d_cam @ R_cam
        d_prop = d_world @ R_prop
        turned_cam = cam - state.cam_from_world.t[seen.camera]
        turned_world = world - state.world_from_prop.t[seen.time_step]
        turned_prop = prop - state.prop_from_patch.t[seen.patch]
        blocks = (
            ResidualBlock(_pose_jacobian(d_cam, turned_cam), seen.camera, len(state.cam_from_world)),
            ResidualBlock(_pose_jacobian(d_prop, turned_prop), seen.patch, len(state.prop_from_patch)),
            ResidualBlock(self._clock_jacobian(), seen.camera, len(state.cam_from_world)),
            self._lens_block(state, lenses, cam),
            ResidualBlock(self._turn_jacobian(d_cam, cam), seen.camera, len(state.cam_from_world)),
        )
        return Linearised(blocks, _pose_jacobian(d_world, turned_world), seen.time_step)

    def _clock_jacobian(self) -> Array:
        per_offset = -self._seen.velocity_px_s / self._sigma_px
        per_drift = per_offset * self._seen.t_s[self._seen.time_step][:, None]
        return np.asarray(np.stack([per_offset, per_drift], axis=-1) * _DELAY_SCALE_S)

    def _turn_jacobian(self, d_cam: Array, cam: Array) -> Array:
        if not self._freedom.turning:
            return np.zeros((len(cam), 2, 3))
        return np.asarray(-d_cam @ hat(cam) * (self._seen.t_s[self._seen.time_step] * _TURN_SCALE_RAD_S)[:, None, None])

    def _lens_block(self, state: PropState, lenses: Lenses, cam: Array) -> ResidualBlock:
        count = len(state.cam_from_world)
        if self._freedom.lens_sigma is None:
            jacobian = np.zeros((len(cam), 2, len(LENS_PARAMETERS)))
        else:
            jacobian = lenses.lens_jacobian(self._seen.camera, cam) / self._sigma_px
        prior = np.tile(self._lens_prior, (count, 1))
        return ResidualBlock(jacobian, self._seen.camera, count, prior, state.lens_delta)


def _pose_jacobian(d_point: Array, turned: Array) -> Array:
    """(N, 2, 6) by a left rotation vector and a shift, given (N, 2, 3) by the point and the rotated point (N, 3)."""
    return np.concatenate([-d_point @ hat(turned), d_point], axis=2)
