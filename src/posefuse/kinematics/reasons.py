"""Why an angle is not there."""

from __future__ import annotations

from enum import IntEnum

from . import kernels


class Reason(IntEnum):
    """Why an angle is NaN, or that it is not."""

    DEFINED = kernels.DEFINED
    NOT_DETERMINED = kernels.NOT_DETERMINED  # these keypoints never determine it
    MISSING = kernels.MISSING  # a keypoint it needs is missing at this time step
    STRAIGHT_LIMB = kernels.STRAIGHT_LIMB  # the plane of a straight limb was lost too long ago
    GIMBAL_LOCK = kernels.GIMBAL_LOCK  # first and last axis of the sequence are parallel: only their sum is known
    UNCERTAIN = kernels.UNCERTAIN  # the keypoints are known too badly
