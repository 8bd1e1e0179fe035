"""How long the segments of people are: from keypoints at their joint centres, and before anything is measured."""

from __future__ import annotations

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import pick_keypoints

from .body_directions import SIDES

# fewer time steps do not determine the lengths of the person's segments
_LEAST_TIME_STEPS = 10
_ENDS = [[[end.format(side=side) for end in ends] for ends in SEGMENT_ENDS.values()] for side in SIDES]
_POINTS = tuple(dict.fromkeys(end for side in _ENDS for ends in side for end in ends))
_FROM, _TO = np.moveaxis(np.vectorize(_POINTS.index)(np.array(_ENDS)), -1, 0)
# adults of both sexes
_STATURE_M, _STATURE_SIGMA_M = 1.70, 0.10
# segments of `SEGMENT_ENDS`, between joint centres, as shares of stature. Means of de Leva 1996 (joint centres; J. Biomech.
# 29:1223) and Drillis and Contini 1966 (as in Winter, Biomechanics and Motor Control of Human Movement), rounded; shoulders and
# hips, which those give between landmarks of the bones, as in the simulator's bodies
_SHARE = {
    "upper_arm": 0.160, "forearm": 0.150, "thigh": 0.240, "shank": 0.247, "shoulders": 0.196, "hips": 0.107, "trunk": 0.292,
}  # fmt: skip
# standard deviation among people of the same stature, as a share of the length; what the sources disagree by included. The trunk
# ends at the shoulders, which rise by several centimetres with the arms
_SPREAD = {
    "upper_arm": 0.04, "forearm": 0.04, "thigh": 0.05, "shank": 0.05, "shoulders": 0.06, "hips": 0.08, "trunk": 0.08,
}  # fmt: skip


def lengths_at(xyz: Array, skeleton: Skeleton) -> Array:
    """(..., 2, S) metres of `SEGMENT_ENDS` on the left and the right side, from keypoints (..., K, 3); NaN where one is missing.

    What belongs to no side stands on both.
    """
    points = pick_keypoints(xyz, skeleton, _POINTS)
    return np.asarray(np.linalg.norm(points[..., _TO, :] - points[..., _FROM, :], axis=-1))


def segment_lengths(xyz: Array, skeleton: Skeleton) -> Array:
    """(N, S) metres of people's `SEGMENT_ENDS` from keypoints (T, N, K, 3): medians over time and both sides.

    NaN for a segment seen in fewer than ten time steps.
    """
    metres = lengths_at(xyz, skeleton)
    out = np.full((xyz.shape[1], len(SEGMENT_ENDS)), np.nan)
    for n, s in np.ndindex(*out.shape):
        known = metres[:, n, :, s]
        known = known[np.isfinite(known)]
        if len(known) >= _LEAST_TIME_STEPS * len(SIDES):
            out[n, s] = np.median(known)
    return out


def usual_lengths() -> tuple[Array, Array]:
    """Mean (S,) and covariance (S, S) of people's segments in metres: stature and what segments differ by at one stature."""
    share, spread = (np.array([values[segment] for segment in SEGMENT_ENDS]) for values in (_SHARE, _SPREAD))
    mean = _STATURE_M * share
    return mean, np.outer(share, share) * _STATURE_SIGMA_M**2 + np.diag((spread * mean) ** 2)
