"""The lengths of people's segments before anything is measured."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.joint_centres import SEGMENT_ENDS

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


def usual_lengths() -> tuple[Array, Array]:
    """Mean (S,) and covariance (S, S) of people's segments in metres: stature and what segments differ by at one stature."""
    share, spread = (np.array([values[segment] for segment in SEGMENT_ENDS]) for values in (_SHARE, _SPREAD))
    mean = _STATURE_M * share
    return mean, np.outer(share, share) * _STATURE_SIGMA_M**2 + np.diag((spread * mean) ** 2)
