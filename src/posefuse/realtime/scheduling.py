"""Which view to process next when there is not time for all: the one with the largest expected information gain."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from posefuse.core import Camera, Pose3D, Rig
from posefuse.core.arrays import Array

# every view is processed at least this often: only then is it known that a person can be seen in it again
LEAST_EVERY_S = 0.4


def search_slot(now_ns: int, every_s: float) -> int:
    """The number of the stretch of time in which every camera searches its whole image once, at its first look.

    It is the same for all cameras: a new person is found where two of them see them at about the same time.
    """
    return now_ns // round(every_s * 1e9)


def expected_gain(pose: Pose3D, rig: Rig, sigma_px: Array) -> Array:
    """(C,) information one frame of each camera would add to a predicted pose, in nats.

    A keypoint with covariance P, seen through the projection's Jacobian J with pixel noise s, gains
    1/2 log det(I + J P J' / s^2); keypoints outside the image gain nothing. P grows while no one looks, and most
    along directions no recent view has measured, so a view is worth more the longer it and its like were left out.

    Args:
        pose: predicted to the time of the next frames. rig: the cameras.
        sigma_px: (C,) usual noise of each camera's keypoints.
    """
    from . import kernels

    out = np.empty(len(rig))
    kernels.gain(_packed(rig), np.asarray(sigma_px, np.float64), pose.xyz_world, pose.cov_world, out)
    return out


@lru_cache(maxsize=4)
def _packed(rig: Rig) -> Array:
    """(C, CAMERA_SIZE) as the kernel reads them."""
    return np.array([_columns(camera) for camera in rig])


def _columns(camera: Camera) -> Array:
    pose, focal, centre = camera.cam_from_world, camera.K[[0, 1], [0, 1]], camera.K[:2, 2]
    return np.concatenate([pose.matrix().ravel(), pose.xyz, focal, centre, camera.size_wh])
