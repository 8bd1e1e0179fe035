"""Which view to look at next when there is not time for all: the one that is expected to tell most."""

from __future__ import annotations

import numpy as np

from posefuse.core import Camera, Pose3D, Rig
from posefuse.core.arrays import Array

# a view is looked at this often whatever it is worth: only a look tells that somebody can be seen again
LEAST_EVERY_S = 0.4
_EDGE_PX = 4.0


def search_slot(now_ns: int, every_s: float) -> int:
    """The number of the stretch of time in which every camera searches its whole image once, at its first look.

    It is the same for all cameras: somebody new is found where two of them see them at about the same time.
    """
    return now_ns // round(every_s * 1e9)


def expected_gain(pose: Pose3D, rig: Rig, sigma_px: Array) -> Array:
    """(C,) information one frame of each camera would add to a predicted pose, in nats.

    A keypoint with covariance P, seen through the projection's Jacobian J with pixel noise s, gains
    1/2 log det(I + J P J' / s^2); keypoints outside the picture gain nothing. P grows while nobody looks, and most
    along directions no recent view has measured, so a view is worth more the longer it and its like were left out.

    Args:
        pose: predicted to the time of the next frames. rig: the cameras.
        sigma_px: (C,) usual noise of each camera's keypoints.
    """
    known = np.isfinite(pose.xyz_world).all(axis=-1) & np.isfinite(pose.cov_world).all(axis=(-1, -2))
    xyz, cov = pose.xyz_world[known], pose.cov_world[known]
    if not len(xyz):
        return np.zeros(len(rig))
    return np.array([_gain(camera, xyz, cov, sigma) for camera, sigma in zip(rig, sigma_px, strict=True)])


def _gain(camera: Camera, xyz: Array, cov: Array, sigma_px: float) -> float:
    xyz_cam = camera.cam_from_world @ xyz
    z = xyz_cam[:, 2]
    front = z > 0.1
    if not front.any():
        return 0.0
    xyz_cam, cov, z = xyz_cam[front], cov[front], z[front]
    x, y = xyz_cam[:, 0] / z, xyz_cam[:, 1] / z
    u, v = camera.K[0, 0] * x + camera.K[0, 2], camera.K[1, 1] * y + camera.K[1, 2]
    width, height = camera.size_wh
    inside = (u > _EDGE_PX) & (u < width - _EDGE_PX) & (v > _EDGE_PX) & (v < height - _EDGE_PX)
    zero = np.zeros_like(z)
    by_cam = np.stack([np.stack([1 / z, zero, -x / z], -1), np.stack([zero, 1 / z, -y / z], -1)], axis=-2)
    jacobian = (camera.K[[0, 1], [0, 1]][:, None] / sigma_px) * by_cam @ camera.cam_from_world.matrix()
    inner = jacobian @ cov @ np.swapaxes(jacobian, -1, -2)
    determinant = (1 + inner[:, 0, 0]) * (1 + inner[:, 1, 1]) - inner[:, 0, 1] * inner[:, 1, 0]
    return float(0.5 * np.log(np.maximum(determinant[inside], 1.0)).sum())
