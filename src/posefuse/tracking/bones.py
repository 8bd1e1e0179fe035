"""Bones keep their length: a soft prior that holds the keypoints of one time step together."""

from __future__ import annotations

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import SIGMA_PER_MAD, Array

# chosen, not fitted: the median of ten lengths scatters by about 0.4 of what one does
_MIN_TIME_STEPS = 10
# chosen, not fitted: from three steps on the end is far nearer to the minimum than the minimum to the truth
_ITERATIONS = 3
# time steps solved at once, which bounds the memory for slopes (T, B, K, 3) of a long recording; results do not depend on it
_CHUNK = 256


def bone_lengths(xyz: Array, cov: Array, used: Array, skeleton: Skeleton, sigma_min_m: float) -> tuple[Array, Array]:
    """Length (B,) of each bone over a recording and how constant it was, as a standard deviation (B,), in metres.

    Args:
        xyz, cov, used: (T, K, 3), (T, K, 3, 3), (T, K) bool: which time steps count.
        skeleton: its bones.
        sigma_min_m: the least spread that is believed.

    Returns:
        NaN for a bone seen in fewer than ten time steps. The length is the median, less what noise across the bone adds to
        a distance; the spread is that of the lengths beyond what the covariances explain.
    """
    centre, spread = np.full((2, len(skeleton.bone_indices)), np.nan)
    for b, (one, two) in enumerate(skeleton.bone_indices.tolist()):
        span, both = xyz[:, one] - xyz[:, two], cov[:, one] + cov[:, two]
        distance = np.linalg.norm(span, axis=-1)
        counts = used[:, one] & used[:, two] & np.isfinite(distance)
        if counts.sum() < _MIN_TIME_STEPS:
            continue
        divisor = np.where(distance > 1e-9, distance, np.nan)
        along = span / divisor[:, None]
        variance = np.einsum("ti,tij,tj->t", along, both, along)
        across = np.trace(both, axis1=-2, axis2=-1) - variance
        length = np.where(counts, distance - across / (2 * divisor), np.nan)
        centre[b] = np.nanmedian(length)
        seen = SIGMA_PER_MAD * np.nanmedian(np.abs(length - centre[b]))
        noise = np.nanmedian(np.where(counts, variance, np.nan))
        spread[b] = np.sqrt(np.maximum(seen**2 - noise, sigma_min_m**2))
    return centre, spread


def hold_bones(xyz: Array, cov: Array, used: Array, skeleton: Skeleton, sigma_min_m: float) -> None:
    """One person's keypoints (T, K, 3) and covariances (T, K, 3, 3), given also that bones keep their length, in place.

    Iterated extended Kalman update of each time step with one pseudo-measurement per bone, |a - b| = length with its spread
    (`bone_lengths`): the Gauss-Newton minimum of the keypoints' Mahalanobis distances plus the bones' squared errors.
    Missing keypoints stay missing, and bones that end in one carry no information.
    """
    length, spread = bone_lengths(xyz, cov, used, skeleton, sigma_min_m)
    known = np.flatnonzero(np.isfinite(length) & (length > 0.02))
    if not len(known):
        return
    ends = skeleton.bone_indices[known]
    for start in range(0, len(xyz), _CHUNK):
        part = slice(start, start + _CHUNK)
        xyz[part], cov[part] = _hold(xyz[part], cov[part], ends, length[known], spread[known])


def _hold(xyz: Array, cov: Array, ends: Array, length: Array, spread: Array) -> tuple[Array, Array]:
    there = np.asarray(np.isfinite(xyz).all(axis=-1) & np.isfinite(cov).all(axis=(-1, -2)))
    prior = np.where(there[..., None], xyz, 0.0)
    prior_cov = np.where(there[..., None, None], cov, 0.0)
    held, (count, keypoints) = prior, xyz.shape[:2]
    for _ in range(_ITERATIONS):
        along, distance = _directions(held, there, ends)
        # J and J P: covariances of different keypoints are independent
        slope = _at_ends(along, along, ends, keypoints)
        one, two = ((along[..., None, :] @ prior_cov[:, end])[..., 0, :] for end in ends.T)
        pushed = _at_ends(one, two, ends, keypoints)
        innovation = pushed @ slope.transpose(0, 2, 1) + np.diag(spread**2)
        expected = distance + (slope @ (prior - held).reshape(count, -1, 1))[..., 0]
        error = np.where(distance > 0, length - expected, 0.0)
        held = prior + (pushed.transpose(0, 2, 1) @ np.linalg.solve(innovation, error[..., None])).reshape(prior.shape)
    by_keypoint = (count, len(ends), keypoints, 3)
    weighted = np.linalg.solve(innovation, pushed).reshape(by_keypoint).transpose(0, 2, 1, 3)
    narrowed = prior_cov - pushed.reshape(by_keypoint).transpose(0, 2, 3, 1) @ weighted
    return np.where(there[..., None], held, np.nan), np.where(there[..., None, None], narrowed, np.nan)


def _directions(xyz: Array, there: Array, ends: Array) -> tuple[Array, Array]:
    """Unit vectors from the second to the first end of each bone (T, B, 3), and its length (T, B); 0 where an end is missing."""
    span = xyz[:, ends[:, 0]] - xyz[:, ends[:, 1]]
    distance = np.linalg.norm(span, axis=-1)
    both = there[:, ends[:, 0]] & there[:, ends[:, 1]] & (distance > 1e-6)
    unit = np.where(both[..., None], span / np.where(both, distance, 1.0)[..., None], 0.0)
    return unit, np.where(both, distance, 0.0)


def _at_ends(one: Array, two: Array, ends: Array, keypoints: int) -> Array:
    """(T, B, 3 K) rows that are `one` (T, B, 3) at the first end of each bone, less `two` at the second, 0 elsewhere."""
    rows = np.zeros((len(one), len(ends), keypoints, 3))
    each = np.arange(len(ends))
    rows[:, each, ends[:, 0]] = one
    rows[:, each, ends[:, 1]] = -two
    return rows.reshape(len(one), len(ends), -1)
