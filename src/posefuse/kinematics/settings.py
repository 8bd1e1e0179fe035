"""Settings of segment frames and joint angles."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt

from posefuse.foundation.settings import settings


@settings
class JointSettings:
    """How frames and angles behave where the points leave them open.

    Attributes:
        turn_rate_rad_sqrt_s: how fast the plane of a limb wanders unseen: standard deviation after one second.
        hinge_play_rad: how far a knee or elbow departs from an ideal hinge; limits the trust in the plane of a nearly
            straight limb.
        lock_rad: nearer than this to gimbal lock the first and last angle of a sequence are NaN.
        sigma_limit_rad: an angle less certain than this is NaN.
        unknown_sigma_m: standard deviation taken for points that come without a covariance.
        sides_checked: refuse a recording whose left and right are plainly swapped.
    """

    turn_rate_rad_sqrt_s: Annotated[float, Gt(0)] = 0.7
    hinge_play_rad: Annotated[float, Ge(0)] = 0.05
    lock_rad: Annotated[float, Ge(0)] = 0.12
    sigma_limit_rad: Annotated[float, Gt(0)] = 0.6
    unknown_sigma_m: Annotated[float, Gt(0)] = 0.01
    sides_checked: bool = True
