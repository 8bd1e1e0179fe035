"""Bundle adjustment of cameras that watch moving rigid props (after Sarmadi et al. 2019, section 3.4), or free points.

Unknown: the pose of every patch (marker) on the prop, of the prop at every time step, of every camera; on request each
camera's clock (offset and drift) and lens. Held: the first camera at the origin and one patch on each prop. A point, such as a
keypoint of a person at a time step, is a prop of one corner, which has a place and no orientation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from posefuse.calibration.bundle import Linearised, Problem, ResidualBlock, Solution, clustered_covariance, solve_bundle
from posefuse.calibration.geometry import LENS_PARAMETERS, Lenses, Poses, hat
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .snapshots import Snapshots

_LEAST_SIGMA_PX = 0.05
_DELAY_SCALE_S = np.array([1e-3, 1e-5])
# stretches of a recording whose scatter the standard errors answer for
_TIME_BLOCKS = 16
# a view agrees within so many standard deviations, which are this at least, px
_INLIER_SIGMA, _LEAST_AGREEING_PX = 4.0, 0.2
_LEAST_JUDGED = 6


@dataclass(frozen=True)
class Loss:
    """How residuals count.

    Attributes:
        rough_px: noise of a coordinate before any is found. cauchy: scales of the robust loss, in standard deviations, of the
            solve with that noise and of the one with the noise found.
    """

    rough_px: float
    cauchy: tuple[float, float]


# corners (M, n, 3) of what is a point, and how residuals of corners and of keypoints count
POINT = np.zeros((1, 1, 3))
CORNERS, KEYPOINTS = Loss(2.0, (1.0, 3.0)), Loss(8.0, (2.0, 2.0))


@dataclass(frozen=True, eq=False)
class PropState:
    """All unknowns.

    Attributes:
        cam_from_world: (C,). world_from_prop: (T,), each of one prop. prop_from_patch: (M,).
        delay_s: (C, 2) clock offset in s and drift in s/s, as in `snapshots`.
        lens_delta: (C, 6) correction of `LENS_PARAMETERS`.
    """

    cam_from_world: Poses
    world_from_prop: Poses
    prop_from_patch: Poses
    delay_s: Array
    lens_delta: Array

    @classmethod
    def starting(cls, cam_from_world: Poses, track: Poses, prop_from_patch: Poses, delay_s: Array) -> PropState:
        """Where a solve starts: the prop along its `track`, NaN where that is unknown, intrinsics as given."""
        count, world_from_prop = len(cam_from_world), Poses(track.R, np.nan_to_num(track.t))
        return cls(cam_from_world, world_from_prop, prop_from_patch, delay_s, np.zeros((count, len(LENS_PARAMETERS))))

    @classmethod
    def of_points(cls, cam_from_world: Poses, xyz: Array) -> PropState:
        """The same of points (P, 3), seen at the times at which they were read."""
        count = len(cam_from_world)
        return cls.starting(cam_from_world, replace(Poses.identity(len(xyz)), t=xyz), Poses.identity(1), np.zeros((count, 2)))


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
        scale: camera and axis of the translation that is held where no corner has a size; None where corners set the scale.
    """

    reference: int | None
    held_patches: tuple[int, ...] | None
    offset: bool = False
    drift: bool = False
    lens_sigma: Array | None = None
    lens_of: tuple[int, ...] | None = None
    moving: tuple[int, ...] | None = None
    scale: tuple[int, int] | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class PropSolution:
    """Where the solve stopped.

    Attributes:
        state: unknowns. sigma_px: robust spread of a corner coordinate of usual noise.
        residual_px: (N, 2) predicted minus observed.
        camera_covariance: (C, 6, 6) of rotation vector (rad) and translation (m) of cam_from_world, relative to the reference;
            like all standard errors here at least the scatter between parts of the recording.
        delay_sigma_s: (C, 2) standard errors of the clocks; 0 where held.
        lens_covariance: (C, 6, 6) of `LENS_PARAMETERS`; 0 where held.
        predicted_sigma_px: (N,) standard error of where the camera as found sees a point, by its pose, clock and intrinsics.
    """

    state: PropState
    sigma_px: float
    residual_px: Array
    camera_covariance: Array
    delay_sigma_s: Array
    lens_covariance: Array
    predicted_sigma_px: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class SolvedRig:
    """A solved rig before any check, in any world.

    Attributes:
        cameras: as given. seen: the corners used. corners: (M, n, 3) of each patch. solution: unknowns and residuals.
        freedom: of the poses of cameras and patches alone. loss: of the residuals.
    """

    cameras: tuple[Camera, ...]
    seen: Snapshots
    corners: Array
    solution: PropSolution
    freedom: Freedom
    loss: Loss = CORNERS

    @property
    def inlier(self) -> Array:
        """(groups,) whether a marker in an image agrees with the solution: every corner within 4 robust standard deviations.

        Corners can be sharper than time stamps and lenses are right: what they show of these is not that a camera moved.
        """
        sigma_px = (max(self.solution.sigma_px, _LEAST_AGREEING_PX) * self.seen.noise)[:, None]
        square = np.nan_to_num(((self.solution.residual_px / sigma_px) ** 2).mean(axis=1), nan=np.inf)
        worst = np.zeros(self.seen.group_count)
        np.maximum.at(worst, self.seen.group, square)
        return np.asarray(worst <= _INLIER_SIGMA**2)

    def agreeing(self, parts: int = 1) -> Array:
        """(C, parts) share of each camera's markers in an image, or of its keypoints, that agree, in parts of the recording.

        1 where a part has fewer than 6.
        """
        first, count = self.seen.group_starts(), len(self.cameras)
        place = self.seen.camera[first] * parts + _stretch_of(self.seen.t_s, parts)[self.seen.time_step[first]]
        there = np.bincount(place, minlength=count * parts)
        agree = np.bincount(place, self.inlier, count * parts)
        share = np.where(there < _LEAST_JUDGED, 1.0, agree / np.maximum(there, 1))
        return np.asarray(share.reshape(count, parts))

    def again(self, **freed: Any) -> Self:
        """Solved once more from here, with the fields `freed` of `Freedom` besides the poses of cameras and patches."""
        freedom, state = replace(self.freedom, **freed), self.solution.state
        return replace(self, solution=solve_prop(self.seen, self.corners, self.cameras, state, freedom, self.loss))

    def with_camera_apart(self, c: int, part: Array) -> Self:
        """Solved with further cameras in the place of `c`, behind all others: one for each number above 0 in part (N,)."""
        count, state = len(self.cameras), self.solution.state
        every = np.r_[:count, np.full(int(part.max(initial=0)), c)]
        start = replace(
            state,
            cam_from_world=state.cam_from_world[every],
            delay_s=state.delay_s[every],
            lens_delta=state.lens_delta[every],
        )
        seen = replace(self.seen, camera=np.where(part > 0, count + part - 1, self.seen.camera))
        seen = seen.rows(np.ones(len(part), bool))
        cameras, solution = tuple(self.cameras[i] for i in every), replace(self.solution, state=start)
        return replace(self, cameras=cameras, seen=seen, solution=solution).again()


def focal_change(free: SolvedRig) -> tuple[Array, Array]:
    """(C,) by which share each camera's focal length would rather be longer than given, and standard errors; 0 where held.

    As of one that both axes share: a person who walks hardly shows the upright one by itself.
    """
    focal_px = np.array([camera.K[0, 0] for camera in free.cameras])[:, None]
    change = free.solution.state.lens_delta[:, :2] / focal_px
    weight = np.linalg.pinv(free.solution.lens_covariance[:, :2, :2] / focal_px[..., None] ** 2, hermitian=True).sum(axis=2)
    known = np.maximum(weight.sum(axis=1), 1e-300)
    sigma = np.where(weight.any(axis=1), 1 / np.sqrt(known), 0.0)
    return (weight * change).sum(axis=1) / known, sigma


def focal_sigma(cameras: Sequence[Camera], share: float) -> Array:
    """(6,) standard errors of `LENS_PARAMETERS` that let the focal lengths alone free, known to a share of them."""
    focal_px = share * float(np.mean([camera.K[0, 0] for camera in cameras]))
    return np.array([focal_px, focal_px, 0, 0, 0, 0])


def solve_prop(
    seen: Snapshots, corners: Array, cameras: tuple[Camera, ...], start: PropState, freedom: Freedom, loss: Loss = CORNERS
) -> PropSolution:
    """Two robust solves: one with a wide loss to come near, one with the noise found by the first.

    `corners` (M, n, 3): corners of each patch in its own frame. `start.delay_s` is the delay the snapshots were taken
    with; the clock columns move them along their image velocity from there.
    """
    given = (seen, corners, cameras, start, freedom)
    first = solve_bundle(_PropProblem(*given, sigma_px=loss.rough_px, cauchy=loss.cauchy[0]), start)
    sigma_px = first.spread_px(loss.rough_px, _LEAST_SIGMA_PX)
    second = solve_bundle(_PropProblem(*given, sigma_px=sigma_px, cauchy=loss.cauchy[1]), first.state)
    return _summary(second, sigma_px, freedom, seen)


def residuals_px(seen: Snapshots, corners: Array, cameras: tuple[Camera, ...], state: PropState) -> Array:
    """(N, 2) predicted minus observed px of corners that were read at the clocks of the state; arguments as of `solve_prop`."""
    held = Freedom(reference=None, held_patches=None)
    residual = _PropProblem(seen, corners, cameras, state, held, sigma_px=1.0, cauchy=1.0).residual(state)
    return np.asarray(residual * seen.noise[:, None])


def _summary(solution: Solution[PropState], assumed_px: float, freedom: Freedom, seen: Snapshots) -> PropSolution:
    """Standard errors by the noise that was found instead of the noise that was assumed."""
    noise_px = assumed_px * seen.noise[:, None]
    sigma_px = solution.spread_px(assumed_px, _LEAST_SIGMA_PX)
    scale = (sigma_px / assumed_px) ** 2
    count = len(solution.state.cam_from_world)
    free = np.concatenate([mask.ravel() for mask in _free(solution.state, freedom)])
    full = np.zeros((len(free), len(free)))
    covariance = clustered_covariance(solution.covariance * scale, solution.scores / scale, _stretch_of(seen.t_s, _TIME_BLOCKS))
    full[np.ix_(free, free)] = covariance
    # pose, clock and intrinsics of each camera
    clocks = 6 * count + 6 * len(solution.state.prop_from_patch)
    begins = ((0, 6), (clocks, 2), (clocks + 2 * count, len(LENS_PARAMETERS)))
    own = [np.concatenate([begin + size * i + np.arange(size) for begin, size in begins]) for i in range(count)]
    joint = np.stack([full[np.ix_(one, one)] for one in own])
    poses, _, *others = (block.jacobian * noise_px[..., None] for block in solution.linear.blocks)
    slope, predicted_px2 = np.concatenate([poses, *others], axis=2), np.zeros(len(seen.camera))
    for i in range(count):
        mine = slope[seen.camera == i]
        predicted_px2[seen.camera == i] = np.einsum("nai,ij,naj->n", mine, joint[i], mine)
    return PropSolution(
        state=solution.state,
        sigma_px=sigma_px,
        residual_px=solution.residual * noise_px,
        camera_covariance=joint[:, :6, :6],
        delay_sigma_s=np.sqrt(np.diagonal(joint[:, 6:8, 6:8], axis1=1, axis2=2)) * _DELAY_SCALE_S,
        lens_covariance=joint[:, 8:, 8:],
        predicted_sigma_px=np.sqrt(np.maximum(predicted_px2, 0.0)),
    )


def _stretch_of(t_s: Array, count: int) -> Array:
    """(T,) which of `count` stretches of equal length each time step belongs to."""
    first, last = (float(t_s.min()), float(t_s.max())) if len(t_s) else (0.0, 0.0)
    return np.minimum(((t_s - first) / max(last - first, 1e-9) * count).astype(np.int64), count - 1)


def _free(state: PropState, freedom: Freedom) -> tuple[Array, ...]:
    cameras, clocks = (np.zeros((len(state.cam_from_world), n), bool) for n in (6, 2))
    patches = np.zeros((len(state.prop_from_patch), 6), bool)
    if freedom.moving is not None or freedom.reference is not None:
        others = np.arange(len(cameras)) != freedom.reference
        if freedom.moving is not None:
            others = np.isin(np.arange(len(cameras)), freedom.moving)
        cameras[others], clocks[others] = True, (freedom.offset, freedom.drift)
    if freedom.scale is not None:
        cameras[freedom.scale[0], 3 + freedom.scale[1]] = False
    if freedom.held_patches is not None:
        patches[~np.isin(np.arange(len(patches)), freedom.held_patches)] = True
    lens = np.zeros((len(cameras), len(LENS_PARAMETERS)), bool)
    if freedom.lens_sigma is not None:
        lens[:] = freedom.lens_sigma > 0
    if freedom.lens_of is not None:
        lens &= np.isin(np.arange(len(cameras)), freedom.lens_of)[:, None]
    return cameras, patches, clocks, lens


class _PropProblem(Problem[PropState]):
    """Residuals and Jacobians of the corners."""

    def __init__(
        self, seen: Snapshots, corners: Array, cameras: tuple[Camera, ...], start: PropState, freedom: Freedom, *,
        sigma_px: float, cauchy: float,
    ) -> None:  # fmt: skip
        self._seen, self._cameras, self._freedom, self._sigma_px = seen, cameras, freedom, sigma_px * seen.noise[:, None]
        self.free, self.local_count, self.cauchy = _free(start, freedom), len(start.world_from_prop), cauchy
        self.group, self.group_count = seen.group, seen.group_count
        self._xyz_patch, self._points = corners[seen.patch, seen.corner], corners.shape[1] == 1
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
        camera, patch, clock, lens = blocks
        if self._points:
            local = np.concatenate([np.zeros_like(local), local], axis=1)
        return replace(
            state,
            cam_from_world=state.cam_from_world.stepped(camera),
            prop_from_patch=state.prop_from_patch.stepped(patch),
            delay_s=state.delay_s + clock * _DELAY_SCALE_S,
            lens_delta=state.lens_delta + lens,
            world_from_prop=state.world_from_prop.stepped(local),
        )

    def _placed(self, state: PropState) -> tuple[Array, Array, Array, Lenses]:
        """The corners (N, 3) in axes of the prop, of the world and of the camera that sees them; and the lenses."""
        seen = self._seen
        prop = state.prop_from_patch[seen.patch].move(self._xyz_patch)
        world = state.world_from_prop[seen.time_step].move(prop)
        cam = state.cam_from_world[seen.camera].move(world)
        return prop, world, cam, Lenses(self._cameras, state.lens_delta)

    def linearise(self, state: PropState) -> Linearised:
        seen = self._seen
        prop, world, cam, lenses = self._placed(state)
        d_cam = lenses.px_jacobian(seen.camera, cam) / self._sigma_px[..., None]
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
        )
        return Linearised(blocks, d_world if self._points else _pose_jacobian(d_world, turned_world), seen.time_step)

    def _clock_jacobian(self) -> Array:
        per_offset = -self._seen.velocity_px_s / self._sigma_px
        per_drift = per_offset * self._seen.t_s[self._seen.time_step][:, None]
        return np.asarray(np.stack([per_offset, per_drift], axis=-1) * _DELAY_SCALE_S)

    def _lens_block(self, state: PropState, lenses: Lenses, cam: Array) -> ResidualBlock:
        count = len(state.cam_from_world)
        if self._freedom.lens_sigma is None:
            jacobian = np.zeros((len(cam), 2, len(LENS_PARAMETERS)))
        else:
            jacobian = lenses.lens_jacobian(self._seen.camera, cam) / self._sigma_px[..., None]
        prior = np.tile(np.diag(self._lens_prior), (count, 1, 1))
        return ResidualBlock(jacobian, self._seen.camera, count, prior, state.lens_delta)


def _pose_jacobian(d_point: Array, turned: Array) -> Array:
    """(N, 2, 6) by a left rotation vector and a shift, given (N, 2, 3) by the point and the rotated point (N, 3)."""
    return np.concatenate([-d_point @ hat(turned), d_point], axis=2)
