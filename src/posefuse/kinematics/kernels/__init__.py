"""The compiled mathematics of segment frames and joint angles.

A frame errs by a small rotation vector omega (world axes), linear in the errors of its points; the angles of a joint err
by M^-1 (omega_child - omega_parent), where the columns of M are the joint's three rotation axes. So covariances of the
points become standard deviations of the angles in closed form.

The turn of a limb's segments about their long axes comes from the plane of the limb, which a straight limb does not have.
It is a scalar Kalman filter: the last plane is carried in the axes of the parent segment by the smallest rotation that
follows the long axis, its variance grows with time, and each new plane counts by its own variance.
"""

from .angles import (
    DEFINED,
    GIMBAL_LOCK,
    MISSING,
    NOT_DETERMINED,
    STRAIGHT_LIMB,
    UNCERTAIN,
    Angles,
    FrameArrays,
    JointTable,
    SegmentTable,
    solve_joints,
    unwrap,
)  # fmt: skip
from .frames import gather_landmarks, quaternions
from .planes import MEMORY_SIZE, PLANE_SIZE, UNKNOWN_VAR, step_planes

__all__ = [
    "DEFINED",
    "GIMBAL_LOCK",
    "MEMORY_SIZE",
    "MISSING",
    "NOT_DETERMINED",
    "PLANE_SIZE",
    "STRAIGHT_LIMB",
    "UNCERTAIN",
    "UNKNOWN_VAR",
    "Angles",
    "FrameArrays",
    "JointTable",
    "SegmentTable",
    "gather_landmarks",
    "quaternions",
    "solve_joints",
    "step_planes",
    "unwrap",
]  # fmt: skip
