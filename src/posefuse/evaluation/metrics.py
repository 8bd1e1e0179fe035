"""How far an estimate is from the truth, joint by joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.core import InputError, PoseSequence, Truth
from posefuse.core.arrays import MEDIAN_CHI2, Array
from posefuse.core.skeleton import PAPER14, pick_keypoints

# over less the noise of the ends is no drift
_LEAST_WALKED_M = 0.5


@dataclass(frozen=True)
class JointErrors:
    """Position errors of named joints over a recording, all people together.

    Attributes:
        joints: names, axis K below.
        mean_mm, sd_mm, median_mm, p95_mm: (K,) over the time steps at which the joint was estimated; NaN if never.
        found: (K,) share of time steps with an estimate.
    """

    joints: tuple[str, ...]
    mean_mm: Array
    sd_mm: Array
    median_mm: Array
    p95_mm: Array
    found: Array

    @property
    def mpjpe_mm(self) -> float:
        """Mean over joints of the mean error (the paper's "average")."""
        return float(np.nanmean(self.mean_mm)) if np.isfinite(self.mean_mm).any() else float("nan")


def joint_errors(estimate: PoseSequence, truth: Truth, joints: Sequence[str] = PAPER14.keypoints) -> JointErrors:
    """MPJPE per joint (paper, eq. 1) of the estimate against the truth; see `joint_distances_mm`."""
    return summary(joints, joint_distances_mm(estimate, truth, joints))


def joint_distances_mm(estimate: PoseSequence, truth: Truth, joints: Sequence[str] = PAPER14.keypoints) -> Array:
    """(T, N_true, K) distances of the estimate from the truth at the estimate's own times; NaN where there is no estimate.

    The truth is interpolated linearly between its time steps; time steps outside them do not count. People are paired by
    the smallest mean distance.

    Raises:
        InputError: no time step in common.
    """
    inside = (estimate.t_ns >= truth.t_ns[0]) & (estimate.t_ns <= truth.t_ns[-1])
    if not inside.any():
        raise InputError("truth and estimate have no time step in common: check the clocks of the session")
    true_xyz = true_xyz_at(truth, estimate.t_ns[inside])
    wanted = pick_keypoints(true_xyz, truth.skeleton, joints)
    got = pick_keypoints(estimate.xyz_world[inside], estimate.skeleton, joints)
    return 1000 * _paired_distance_m(got, wanted)


def summary(joints: Sequence[str], distance_mm: Array) -> JointErrors:
    """Statistics of distances (..., K) in mm over all leading axes; NaN is a missing estimate."""
    flat = distance_mm.reshape(-1, distance_mm.shape[-1])
    columns = [column[np.isfinite(column)] for column in flat.T]

    def each(statistic: object) -> Array:
        return np.array([statistic(c) if len(c) else np.nan for c in columns])  # type: ignore[operator]

    return JointErrors(
        tuple(joints),
        each(np.mean),
        each(np.std),
        each(np.median),
        each(lambda c: np.percentile(c, 95)),
        np.array([len(c) / max(len(flat), 1) for c in columns]),
    )


def typical_nees(estimate: PoseSequence, truth: Truth, joints: Sequence[str]) -> float:
    """How the stated covariances fit the errors of one person's joints: 3 is right, more is overconfident.

    The median of e^T cov^-1 e over joints and time steps, times what makes the median of a chi-square of 3 degrees of freedom 3;
    midpoints (neck, mid_hip) have no covariance of their own and cannot be asked for.
    """
    inside = (estimate.t_ns >= truth.t_ns[0]) & (estimate.t_ns <= truth.t_ns[-1])
    columns = estimate.skeleton.indices(joints)
    error = estimate.xyz_world[inside, 0][:, columns] - pick_keypoints(
        true_xyz_at(truth, estimate.t_ns[inside])[:, 0], truth.skeleton, joints
    )
    cov = estimate.cov_world[inside, 0][:, columns]
    known = np.isfinite(error).all(axis=-1) & np.isfinite(cov).all(axis=(-1, -2))
    solved = np.linalg.solve(cov[known], error[known][..., None])[..., 0]
    return float(np.median((error[known] * solved).sum(axis=-1)) * 3 / MEDIAN_CHI2) if known.any() else float("nan")


def true_xyz_at(truth: Truth, t_ns: Array) -> Array:
    """(T, N, K, 3) truth at other times (T,) within its own, interpolated linearly."""
    last = len(truth.t_ns) - 1
    later = np.searchsorted(truth.t_ns, t_ns).clip(min(1, last), last)
    earlier = np.maximum(later - 1, 0)
    span = np.maximum(truth.t_ns[later] - truth.t_ns[earlier], 1)
    share = ((t_ns - truth.t_ns[earlier]) / span)[:, None, None, None]
    return np.asarray(truth.xyz_world[earlier] * (1 - share) + truth.xyz_world[later] * share)


def drift(path_m: Array, other_m: Array) -> tuple[Array, Array, float]:
    """How another path (T, 3) leaves a path (T, 3) on the level, both in metres, NaN where missing.

    Returns:
        (T,) length of the path so far, straight where it is missing; (T,) level distance of the two; slope of the least-squares
        line of distance over length in mm per m, NaN for less than half a metre.
    """
    at = np.flatnonzero(np.isfinite(path_m[:, :2]).all(axis=-1))
    steps = np.linalg.norm(np.diff(path_m[at, :2], axis=0), axis=-1)
    walked = np.interp(np.arange(len(path_m)), at, np.cumsum([0.0, *steps])) if len(at) else np.zeros(len(path_m))
    apart = np.linalg.norm((other_m - path_m)[:, :2], axis=-1)
    known = np.isfinite(apart)
    enough = known.any() and np.ptp(walked[known]) > _LEAST_WALKED_M
    return walked, apart, 1000 * float(np.polyfit(walked[known], apart[known], 1)[0]) if enough else float("nan")


def _paired_distance_m(got: Array, wanted: Array) -> Array:
    """(T, N_true, K) distances, each true person paired with its nearest estimated one; NaN where there is none."""
    all_pairs = np.linalg.norm(got[:, :, None] - wanted[:, None], axis=-1)
    known = np.isfinite(all_pairs)
    with np.errstate(invalid="ignore"):
        cost = np.where(known, all_pairs, 0.0).sum(axis=(0, 3)) / known.sum(axis=(0, 3))
    distance = np.full((len(got), *wanted.shape[1:3]), np.nan)
    for _ in range(min(cost.shape)):
        if not np.isfinite(cost).any():
            break
        i, j = np.unravel_index(np.nanargmin(cost), cost.shape)
        distance[:, j] = all_pairs[:, i, j]
        cost[i, :] = cost[:, j] = np.nan
    return distance
