"""Extrinsics that are nearly right, refined from the people of a recording: bundle adjustment with a prior on every camera."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.clocks.paths import apart
from posefuse.calibration.clocks.person_tracks import MIN_SCORE, limb_keypoints
from posefuse.calibration.geometry import angle_between, poses_of
from posefuse.calibration.settings import RefineSettings
from posefuse.core import InputError, Rig, ViewSequence
from posefuse.core.arrays import SIGMA_PER_MAD, Array

from .prop_solve import KEYPOINTS, POINT, Freedom, PropState, residuals_px, solve_once
from .snapshots import Snapshots, evenly
from .world import triangulate_linear

# errors of a network last longer than this only where the person stands still
_EVERY_S = 0.3
_MOST_STEPS = 300
_LEAST_SIGMA_PX = 0.5
_IN_FRONT_M = 0.2
# a person who is no farther from an earlier place, and turned no farther, is seen with the same errors of the network again
_ALIKE_M, _ALIKE_RAD = 0.3, 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class RefinedRig:
    """A rig whose extrinsics were refined.

    Attributes:
        rig: with the refined extrinsics. moved_m, turned_rad: (C,) how far each camera is from its calibration.
        before_px, after_px: robust spread of a coordinate (median absolute residual as a standard deviation), with the
            calibrated and with the refined extrinsics, points triangulated with each.
    """

    rig: Rig
    moved_m: Array
    turned_rad: Array
    before_px: float
    after_px: float


def refined_extrinsics(rig: Rig, views: ViewSequence, chosen: RefineSettings | None = None) -> RefinedRig:
    """The cameras' poses that fit what they saw of people best, each pulled towards its calibration.

    The prior on the cameras also fixes the world. Limb joints alone count, in time steps at least 0.3 s apart; Cauchy loss.
    A network's errors stay the same while a person stays in one place: so the information of all time steps counts as that of
    as many as differ in where people were and how they were turned. A person at rest changes next to nothing.
    Method: bundle adjustment, see `calibration.bundle`.

    Args:
        views: of the cameras of `rig`, at common times.

    Raises:
        InputError: views of other cameras; no keypoint is seen by two of them.
    """
    chosen = chosen or RefineSettings()
    if views.camera_names != rig.names:
        raise InputError(f"refined_extrinsics: expected views of cameras {rig.names}, got {views.camera_names}")
    steps = evenly(apart(views.t_ns, round(_EVERY_S * 1e9)), _MOST_STEPS)
    limbs = limb_keypoints(views.skeleton.keypoints)
    rows, xyz, there = _rows(rig, views, steps, limbs)
    if not len(xyz):
        raise InputError("refined_extrinsics: no keypoint was seen by two cameras")
    calibrated, count = poses_of(rig), len(rig)
    start = PropState.of_points(calibrated, xyz)
    before = residuals_px(rows, POINT, rig.cameras, start)
    noise = max(_spread(before / rows.noise[:, None]), _LEAST_SIGMA_PX / float(np.median(rows.noise)))
    whole = np.full((*there.shape, 3), np.nan)
    whole[there] = xyz
    same = chosen.together * _repeated(whole, [views.skeleton.keypoints[k] for k in limbs])
    # as the loss judges outliers by their noise, the prior is made stronger instead of the noise wider
    sigma = np.repeat([chosen.turn_sigma_rad, chosen.move_sigma_m], 3) / np.sqrt(same)
    freedom = Freedom(reference=None, held_patches=None, moving=tuple(range(count)), calibrated=calibrated, pose_sigma=sigma)
    solution = solve_once(rows, POINT, rig.cameras, start, freedom, sigma_px=noise, cauchy=KEYPOINTS.cauchy[1])
    found = solution.state.cam_from_world
    poses = found.se3()
    refined = replace(
        rig, cameras=tuple(replace(camera, cam_from_world=poses[i]) for i, camera in enumerate(rig)), residual_px=float("nan")
    )
    return RefinedRig(
        rig=refined,
        moved_m=np.linalg.norm(refined.centres_world() - rig.centres_world(), axis=-1),
        turned_rad=angle_between(calibrated.R, found.R),
        before_px=_spread(before),
        after_px=_spread(residuals_px(rows, POINT, rig.cameras, solution.state)),
    )


def _rows(rig: Rig, views: ViewSequence, steps: Array, limbs: Array) -> tuple[Snapshots, Array, Array]:
    """Rows of limb joints that two cameras saw in front of them, where these are (P, 3), and which of (T, N, L) they are."""
    xy = np.moveaxis(views.xy_img[steps][..., limbs, :], 2, 0).reshape(len(rig), -1, 2)
    score, sigma = (np.moveaxis(a[steps][..., limbs], 2, 0).reshape(len(rig), -1) for a in (views.score, views.sigma_px))
    good = np.isfinite(xy).all(axis=-1) & (score >= MIN_SCORE) & (sigma > 0)
    xyz = triangulate_linear(rig, np.where(good[..., None], xy, np.nan))
    ahead = np.stack([(camera.cam_from_world @ xyz)[:, 2] for camera in rig]) > _IN_FRONT_M
    good &= ahead
    points = np.flatnonzero((good.sum(axis=0) >= 2) & np.isfinite(xyz).all(axis=-1))
    camera, point = np.nonzero(good[:, points])
    of = points[point]
    seen = np.zeros(xyz.shape[0], bool)
    seen[points] = True
    shape = (len(steps), len(views.person_id), len(limbs))
    rows = Snapshots.of_points(
        np.zeros(len(points)), camera=camera, time_step=point, xy_img=xy[camera, of], velocity_px_s=np.zeros((len(of), 2)),
        noise=sigma[camera, of],
    )  # fmt: skip
    return rows, xyz[points], seen.reshape(shape)


def _repeated(xyz: Array, names: list[str]) -> float:
    """How often each pose of the people (T, N, L, 3) comes, on average: 1 where everyone is always somewhere else."""
    left, right = (np.array([name.startswith(side) for name in names], bool) for side in ("left_", "right_"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a time step without the person, or without one side
        place, across = np.nanmean(xyz, axis=2), np.nanmean(xyz[:, :, right], axis=2) - np.nanmean(xyz[:, :, left], axis=2)
        across = across / np.linalg.norm(across, axis=-1, keepdims=True)
    counts = []
    for n in range(place.shape[1]):
        there = np.isfinite(place[:, n]).all(axis=-1)
        where, facing = place[there, n], across[there, n]
        away = np.linalg.norm(where[:, None] - where, axis=-1) / _ALIKE_M
        # who is seen from one side alone counts as turned like everyone
        turned = np.nan_to_num(np.arccos(np.clip(facing @ facing.T, -1, 1))) / _ALIKE_RAD
        counts.append(np.exp(-(away**2 + turned**2) / 2).sum(axis=1))
    each = np.concatenate(counts)
    return len(each) / float((1 / each).sum())


def _spread(residual: Array) -> float:
    return float(SIGMA_PER_MAD * np.nanmedian(np.abs(residual)))
