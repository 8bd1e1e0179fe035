"""How long the segments of people are, from keypoints at their joint centres."""

from __future__ import annotations

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import pick_keypoints

from .body_directions import SIDES

# fewer time steps do not determine the lengths of the person's segments
_LEAST_INSTANTS = 10
_ENDS = [[[end.format(side=side) for end in ends] for ends in SEGMENT_ENDS.values()] for side in SIDES]
_POINTS = tuple(dict.fromkeys(end for side in _ENDS for ends in side for end in ends))
_FROM, _TO = np.moveaxis(np.vectorize(_POINTS.index)(np.array(_ENDS)), -1, 0)


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
        if len(known) >= _LEAST_INSTANTS * len(SIDES):
            out[n, s] = np.median(known)
    return out
