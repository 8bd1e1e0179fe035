"""How far each camera of a rig is off, measured against the others with a target of known size."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.extrinsics.locate import patch_track, rig_state
from posefuse.calibration.extrinsics.prop_solve import Freedom, PropSolution, solve_prop
from posefuse.calibration.extrinsics.snapshots import Snapshots
from posefuse.calibration.solving.projection import Lenses
from posefuse.calibration.solving.rotations import angle_between
from posefuse.calibration.targets.kinds import Target, patch_corners
from posefuse.core import Rig
from posefuse.core.arrays import Array

# time steps that are measured: of all cameras, and of each at least
_MOST_VIEWS, _LEAST_VIEWS, _ONE_OTHER = 80, 25, 4.0
# intrinsics besides the focal length are taken as given (px, and distortion coefficients)
_HELD_PX, _HELD_BEND, _FREE_FOCAL = 0.01, 1e-6, 0.2


@dataclass(frozen=True)
class VerifyLimits:
    """What refuses a camera in verification; each also needs `sigma` standard errors.

    Attributes:
        turn_rad, shift_m: of the pose: 0.2 deg is 14 mm at 4 m. focal_share: of the focal length. late_s: of the clock.
            All by judgement: what the fusion of a person's keypoints begins to show.
        effect_px_per_1000: and what the errors together do to the image, per 1000 px of width: 1.5 is about 0.1 deg. Errors that
            cancel in the image (a longer focal length from farther away) hardly show at a person. Judgement; a real rig of
            four webcams has 0.7.
        sigma: standard errors. views: least views shared with other cameras.
    """

    turn_rad: float = float(np.deg2rad(0.2))
    shift_m: float = 0.012
    focal_share: float = 0.01
    late_s: float = 0.004
    effect_px_per_1000: float = 1.5
    sigma: float = 5.0
    views: int = 10


VERIFY_LIMITS = VerifyLimits()
_JUST_WRONG = 1.01


@dataclass(frozen=True, kw_only=True)
class CameraError:
    """One camera against the others, with standard errors; NaN where it shares too few views.

    Attributes:
        name, views: shared with other cameras. others: cameras it is measured against.
        turn_rad, shift_m: of its pose. focal: share of its focal length. late_s: of its clock.
        effect: what they do together to the image, in px (rms) per 1000 px of width.
        noise_px: spread of a corner coordinate that is left.
        unlikely: how badly all cameras fit while this one is free: mean negative log-likelihood of a corner (Cauchy).
        odd: the others agree without it alone, though by its own error alone it would pass.
    """

    name: str
    views: int
    others: int = 0
    turn_rad: float = np.nan
    turn_sigma: float = np.nan
    shift_m: float = np.nan
    shift_sigma: float = np.nan
    focal: float = np.nan
    focal_sigma: float = np.nan
    late_s: float = np.nan
    late_sigma: float = np.nan
    effect: float = np.nan
    noise_px: float = np.nan
    unlikely: float = np.nan
    odd: bool = False

    @property
    def excess(self) -> float:
        """The largest error over its limit; more than 1 is wrong, NaN is not known."""
        limits = VERIFY_LIMITS
        pairs = (
            (self.turn_rad, self.turn_sigma, limits.turn_rad), (self.shift_m, self.shift_sigma, limits.shift_m),
            (self.focal, self.focal_sigma, limits.focal_share), (self.late_s, self.late_sigma, limits.late_s),
        )  # fmt: skip
        # one camera alone knows the target's distance badly, and in ways that standard errors do not show
        alone = _ONE_OTHER if self.others == 1 else 1.0
        single = max(abs(value) / (alone * max(least, limits.sigma * sigma)) for value, sigma, least in pairs)
        return max(min(single, self.effect / limits.effect_px_per_1000), _JUST_WRONG if self.odd else 0.0)

    @property
    def words(self) -> str:
        """The errors, for people."""
        return (
            f"{self.name} is turned by {np.rad2deg(self.turn_rad):.2f} ± {np.rad2deg(self.turn_sigma):.2f} deg, shifted by"
            f" {self.shift_m * 1e3:.1f} ± {self.shift_sigma * 1e3:.1f} mm, its focal length off by {self.focal:+.2%} ±"
            f" {self.focal_sigma:.2%}, its clock {self.late_s * 1e3:+.1f} ± {self.late_sigma * 1e3:.1f} ms late:"
            f" {self.effect:.1f} px per 1000"
        )


def camera_errors(rig: Rig, seen: Snapshots, target: Target) -> tuple[CameraError, ...]:
    """Each camera against those that are not found wrong.

    As long as one is wrong, the camera goes without which the others agree best: a wrong camera makes others look wrong that are
    measured against it, often more than itself. In the end those that went are measured against those that stayed.
    """
    views = _each_patch_alone(seen)
    trusted, gone = {int(c) for c in np.unique(views.camera)}, []
    found = {c: _against(rig, views, target, c, trusted - {c}) for c in range(len(rig))}
    while len(trusted) > 2:
        known = [found[c] for c in trusted if np.isfinite(found[c].turn_rad)]
        if not any(one.excess > 1 for one in known):
            break
        gone.append(rig.names.index(min(known, key=lambda one: one.unlikely).name))
        trusted.discard(gone[-1])
        again = {c: _against(rig, views, target, c, trusted - {c}) for c in range(len(rig))}
        found |= {c: one for c, one in again.items() if np.isfinite(one.turn_rad)}
    if gone and not any(one.excess > 1 for one in found.values()):
        found[gone[0]] = replace(found[gone[0]], odd=True)
    return tuple(found[c] for c in range(len(rig)))


def _each_patch_alone(seen: Snapshots) -> Snapshots:
    """Every marker at every time step as a target of its own, on at most so many of them that several cameras see."""
    key = seen.time_step * len(seen.patches) + seen.patch
    used, place = np.unique(key, return_inverse=True)
    present = np.zeros((len(used), int(seen.camera.max(initial=0)) + 1), bool)
    present[place, seen.camera] = True
    several = np.flatnonzero(present.sum(axis=1) >= 2)
    chosen = _spread(several, _MOST_VIEWS)
    for c in range(present.shape[1]):
        # a camera that seldom sees the target needs more than its share
        if present[chosen, c].sum() < _LEAST_VIEWS:
            chosen = np.union1d(chosen, _spread(several[present[several, c]], _LEAST_VIEWS))
    number = np.full(len(used), -1)
    number[chosen] = np.arange(len(chosen))
    t_s = seen.t_s[used[chosen] // len(seen.patches)]
    alone = replace(seen, t_s=t_s, time_step=number[place], patch=np.zeros(len(place), np.int64), patches=seen.patches[:1])
    return alone.rows(number[place] >= 0)


def _spread(items: Array, most: int) -> Array:
    """So many of them at most, evenly."""
    return np.asarray(items[np.unique(np.linspace(0, len(items) - 1, min(len(items), most)).astype(np.int64))])


def _against(rig: Rig, views: Snapshots, target: Target, c: int, others: Iterable[int]) -> CameraError:
    """One camera's pose, focal length and clock are free, the others fixed."""
    trusted = sorted(others)
    shared = np.unique(views.time_step[np.isin(views.camera, trusted)])
    seen = views.rows(np.isin(views.camera, [*trusted, c]) & np.isin(views.time_step, shared))
    count = len(np.unique(seen.time_step[seen.camera == c]))
    if count < VERIFY_LIMITS.views or not trusted:
        return CameraError(name=rig.names[c], views=count)
    freed = _freed(rig, seen, target, c)
    return (
        CameraError(name=rig.names[c], views=count)
        if freed is None
        else _error(rig, freed[0], freed[1], target=target, c=c, count=count, others=len(trusted))
    )


def _freed(rig: Rig, seen: Snapshots, target: Target, c: int) -> tuple[PropSolution, Snapshots] | None:
    corners, cameras = patch_corners(target, seen.patches), tuple(rig)
    track = patch_track(rig, seen.rows(seen.camera != c), corners)
    known = np.asarray(np.isfinite(track.t).all(axis=1))
    if not known.any():
        return None
    seen = seen.rows(known[seen.time_step])
    focal_px = _FREE_FOCAL * cameras[c].K[0, 0]
    sigma = np.array([focal_px, focal_px, _HELD_PX, _HELD_PX, _HELD_BEND, _HELD_BEND])
    return solve_prop(
        seen,
        corners,
        cameras,
        rig_state(rig, track),
        Freedom(reference=None, held_patches=None, offset=True, drift=False, lens_sigma=sigma, lens_of=(c,), moving=(c,)),
    ), seen


def _effect(rig: Rig, solution: PropSolution, seen: Snapshots, target: Target, c: int) -> float:
    """How far the camera as it is sees points from where the camera of the rig would, px (rms) per 1000 px of width."""
    mine = seen.rows(seen.camera == c)
    corners = patch_corners(target, mine.patches)[mine.patch, mine.corner]
    xyz = solution.state.world_from_prop[mine.time_step].move(corners)
    before, after = rig.cameras[c].cam_from_world @ xyz, solution.state.cam_from_world[mine.camera].move(xyz)
    late_s = solution.state.delay_s[c, 0]
    apart = (
        Lenses(tuple(rig), solution.state.lens_delta).px(mine.camera, after)
        - mine.velocity_px_s * late_s
        - Lenses(tuple(rig)).px(mine.camera, before)
    )
    return float(np.sqrt(np.nanmean((apart**2).sum(axis=1)))) * 1000 / max(rig.cameras[c].size_wh)


def _error(rig: Rig, solution: PropSolution, seen: Snapshots, target: Target, c: int, count: int, others: int) -> CameraError:
    before, after = rig.cameras[c].cam_from_world, solution.state.cam_from_world
    covariance = solution.camera_covariance[c]
    turn = float(angle_between(after.R[c][None], before.matrix()[None])[0])
    shift = float(np.linalg.norm(after.inverse().t[c] - rig.cameras[c].centre_world))
    t = after.t[c]
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    slope = -after.R[c].T @ np.hstack([cross, np.eye(3)])
    mean = np.array([0.5, 0.5, 0, 0, 0, 0]) / rig.cameras[c].K[0, 0]
    off_px = np.linalg.norm(solution.residual_px, axis=1)
    return CameraError(
        name=rig.names[c],
        views=count,
        others=others,
        turn_rad=turn,
        turn_sigma=float(np.sqrt(np.trace(covariance[:3, :3]))),
        shift_m=shift,
        shift_sigma=float(np.sqrt(np.trace(slope @ covariance @ slope.T))),
        focal=float(mean @ solution.state.lens_delta[c]),
        focal_sigma=float(np.sqrt(mean @ solution.lens_covariance[c] @ mean)),
        late_s=float(solution.state.delay_s[c, 0]),
        late_sigma=float(solution.delay_sigma_s[c, 0]),
        effect=_effect(rig, solution, seen, target, c),
        noise_px=solution.sigma_px,
        unlikely=float(np.log(solution.sigma_px) + np.log1p((off_px / solution.sigma_px) ** 2).mean()),
    )
