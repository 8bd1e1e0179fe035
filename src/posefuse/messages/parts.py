"""Wrists, hands and head as poses with covariance, for robots that follow or avoid them.

Axes of every part: x forward, y to the subject's left, z up in the position below (REP-103).

- head: origin in the middle of the ears, y along the ears, x to the nose; looking straight ahead.
- left_wrist, right_wrist: origin in the wrist, axes of the forearm as in REP-155 (`l_wrist`, `r_wrist`); arm hanging. An arm that
  is straight does not show how it is twisted: take the hand then.
- left_hand, right_hand: origin in the middle of the knuckles of index and little finger, x from the wrist to there, z out of the
  back of the hand; arm stretched forward, palm down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import SE3, Pose3D
from posefuse.core.arrays import Array
from posefuse.core.se3 import quaternion_product
from posefuse.core.skeleton import pick_keypoints

from .bodies import LINKS, POINTS, bodies_from_points, unit

PARTS = ("head", "left_wrist", "right_wrist", "left_hand", "right_hand")
_HANDS = ("left_index", "right_index", "left_pinky", "right_pinky")
_NAMES = (*POINTS, *_HANDS)
_FROM_BODY = tuple(LINKS.index(name) for name in ("head", "l_wrist", "r_wrist"))
_WRISTS = tuple(POINTS.index(f"{side}_wrist") for side in ("left", "right"))
_STEP_M = 1e-4


@dataclass(frozen=True, eq=False)
class PartPoses:
    """Parts of people at one time step.

    Attributes:
        world_from_part: batch (N, P), parts in the order of `PARTS`; NaN where not seen.
        cov: (N, P, 6, 6) of x, y, z in metres and of a small turn about the world's x, y, z in rad.
    """

    world_from_part: SE3
    cov: Array


def parts_from_pose(pose: Pose3D) -> PartPoses:
    """Parts of everybody. Errors of keypoints are taken as independent; the covariance is exact to first order."""
    points = pick_keypoints(pose.xyz_world, pose.skeleton, _NAMES)
    n, m = points.shape[:2]
    flat = pose.cov_world.reshape(*pose.cov_world.shape[:2], 9)
    cov = pick_keypoints(flat, pose.skeleton, _NAMES).reshape(n, m, 3, 3)
    # every coordinate of every point moved a little, all in one batch
    moved = points[:, None, None] + _STEP_M * np.eye(3 * m).reshape(m, 3, m, 3)
    together = np.concatenate([points[:, None], moved.reshape(n, 3 * m, m, 3)], axis=1)
    found = _part_frames(together.reshape(-1, m, 3))
    shape = (n, 1 + 3 * m, len(PARTS))
    wxyz, xyz = found.wxyz.reshape(*shape, 4), found.xyz.reshape(*shape, 3)
    here = SE3(wxyz[:, 0], xyz[:, 0])
    away = np.concatenate([xyz[:, 1:] - xyz[:, :1], small_turn(wxyz[:, 1:], wxyz[:, :1])], axis=-1) / _STEP_M
    slope = np.moveaxis(away.reshape(n, m, 3, len(PARTS), 6), 3, 1)
    # a point a part does not depend on may be missing
    counts = np.asarray(np.abs(np.nan_to_num(slope)).max(axis=(-1, -2)) > 0)
    terms = np.einsum("npmai,nmab,npmbj->npmij", slope, cov, slope)
    total = np.where(counts[..., None, None], terms, 0.0).sum(axis=2)
    known = np.asarray(np.isfinite(here.xyz).all(axis=-1))[..., None, None]
    return PartPoses(here, np.where(known, (total + np.swapaxes(total, -1, -2)) / 2, np.nan))


def _part_frames(points: Array) -> SE3:
    """Batch (N, P) from points (N, len(_NAMES), 3)."""
    links = bodies_from_points(points[:, : len(POINTS)]).world_from_link[:, list(_FROM_BODY)]
    knuckles = points[:, len(POINTS) :].reshape(-1, 2, 2, 3)
    index, pinky = knuckles[:, 0], knuckles[:, 1]
    middle = (index + pinky) / 2
    x = unit(middle - points[:, list(_WRISTS)])
    # with the palm down the thumb is on the right of a left hand, and on the left of a right one
    left = (pinky - index) * np.array([1.0, -1.0])[:, None]
    z = unit(np.cross(x, left))
    rotation = np.stack([x, np.cross(z, x), z], axis=-1)
    seen = np.isfinite(rotation).all(axis=(-1, -2)) & np.isfinite(middle).all(axis=-1)
    hands = SE3.from_matrix(np.where(seen[..., None, None], rotation, np.nan), np.where(seen[..., None], middle, np.nan))
    return SE3(np.concatenate([links.wxyz, hands.wxyz], axis=1), np.concatenate([links.xyz, hands.xyz], axis=1))


def small_turn(wxyz: Array, from_wxyz: Array) -> Array:
    """(..., 3) rotation vector of a small turn, world axes."""
    back = np.broadcast_to(from_wxyz, wxyz.shape) * np.array([1.0, -1.0, -1.0, -1.0])
    small = quaternion_product(wxyz, back)
    return np.asarray(2.0 * small[..., 1:] * np.sign(small[..., :1]))
