"""Wrists, hands and head as poses with covariance and velocities, for robots that follow or avoid them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from posefuse.core import SE3, Pose3D
from posefuse.core.arrays import Array
from posefuse.core.se3 import quaternion_product
from posefuse.core.skeleton import SIDES, pick_keypoints

from .bodies import LINKS, POINTS, Bodies, along_last, cross, head_and_wrists, unit_or_nan

PARTS = ("head", "left_wrist", "right_wrist", "left_hand", "right_hand")
_HANDS = ("left_index", "right_index", "left_pinky", "right_pinky")
_NAMES = (*POINTS, *_HANDS)
_FROM_BODY = [LINKS.index(name) for name in ("head", "l_wrist", "r_wrist")]
_WRISTS = tuple(POINTS.index(f"{side}_wrist") for side in SIDES)
# legs do not move a part
_MOVING = [i for i, name in enumerate(_NAMES) if not name.endswith(("_knee", "_ankle"))]
_STEP_M = 1e-4
# (m, 3, k, 3): every coordinate of every point that moves a part moved a little
_MOVED_M = _STEP_M * np.eye(3 * len(_NAMES)).reshape(len(_NAMES), 3, len(_NAMES), 3)[_MOVING]
# what rounding alone makes, in metres or rad per metre, is far below
_NO_SLOPE = 1e-9
Difference = Callable[[Array, Array], Array]
# a step of 10 ms corrected by a new view is uncertain by itself
_SMOOTHED_S = 0.08
_GAP_S = 0.3


def parts_from_pose(pose: Pose3D, bodies: Bodies) -> SE3:
    """World from part, batch (N, P) in the order of `PARTS`, NaN where not seen; `bodies` are those of the pose."""
    return _parts(bodies.world_from_link[:, _FROM_BODY], pick_keypoints(pose.xyz_world, pose.skeleton, _NAMES))


def covariance_of_parts(pose: Pose3D, parts: SE3) -> Array:
    """(N, P, 6, 6) of x, y, z in metres and of a small turn about the world's x, y, z in rad; `parts` are those of the pose.

    Errors of keypoints are taken as independent; the covariance is exact to first order.
    """
    points = pick_keypoints(pose.xyz_world, pose.skeleton, _NAMES)
    n, m = len(points), len(_MOVING)
    flat = pose.cov_world.reshape(*pose.cov_world.shape[:2], 9)
    cov = pick_keypoints(flat, pose.skeleton, _NAMES)[:, _MOVING].reshape(n, m, 3, 3)
    # all in one batch
    moved = (points[:, None, None] + _MOVED_M).reshape(-1, *points.shape[1:])
    found = _parts(head_and_wrists(moved[:, : len(POINTS)]), moved)
    shape = (n, 3 * m, len(PARTS))
    wxyz, xyz = found.wxyz.reshape(*shape, 4), found.xyz.reshape(*shape, 3)
    away = np.concatenate([xyz - parts.xyz[:, None], small_turn(wxyz, parts.wxyz[:, None])], axis=-1) / _STEP_M
    slope = np.moveaxis(away.reshape(n, m, 3, len(PARTS), 6), 3, 1)
    # a point a part does not depend on may be missing
    counts = np.asarray((np.abs(slope) > _NO_SLOPE).any(axis=(-1, -2)))
    terms = np.einsum("npmai,nmab,npmbj->npmij", slope, cov, slope)
    total = np.where(counts[..., None, None], terms, 0.0).sum(axis=2)
    known = np.asarray(np.isfinite(parts.xyz).all(axis=-1))[..., None, None]
    return np.where(known, (total + np.swapaxes(total, -1, -2)) / 2, np.nan)


def _parts(links: SE3, points: Array) -> SE3:
    """Batch (N, P) from the links that are parts, and points (N, len(_NAMES), 3)."""
    knuckles = points[:, len(POINTS) :].reshape(-1, 2, 2, 3)
    index, pinky = knuckles[:, 0], knuckles[:, 1]
    middle = (index + pinky) / 2
    x = unit_or_nan(middle - points[:, list(_WRISTS)])
    # with the palm down the thumb is on the right of a left hand, and on the left of a right one
    left = (pinky - index) * np.array([1.0, -1.0])[:, None]
    z = unit_or_nan(cross(x, left))
    rotation = along_last(x, cross(z, x), z)
    seen = np.asarray(np.isfinite(rotation).all(axis=(-1, -2)) & np.isfinite(middle).all(axis=-1))
    hands = SE3.from_matrix(np.where(seen[..., None, None], rotation, np.nan), np.where(seen[..., None], middle, np.nan))
    return SE3(np.concatenate([links.wxyz, hands.wxyz], axis=1), np.concatenate([links.xyz, hands.xyz], axis=1))


def small_turn(wxyz: Array, from_wxyz: Array) -> Array:
    """(..., 3) rotation vector of a small turn, world axes."""
    back = np.broadcast_to(from_wxyz, wxyz.shape) * np.array([1.0, -1.0, -1.0, -1.0])
    small = quaternion_product(wxyz, back)
    return np.asarray(2.0 * small[..., 1:] * np.sign(small[..., :1]))


class Velocities:
    """Rates of change per person. Values (N, V), given as differences, so that angles may wrap; NaN until two steps are known."""

    def __init__(self) -> None:
        self._t_ns: int | None = None
        self._before: dict[int, tuple[Array, Array]] = {}

    def step(self, t_ns: int, people: Sequence[int], values: Array, difference: Difference) -> Array:
        """(N, D) per second, at the time of the newest values (N, V); `difference(now, before)` is (D,)."""
        dt = (t_ns - self._t_ns) / 1e9 if self._t_ns is not None else np.inf
        went_on = 0.0 < dt < _GAP_S
        weight = 1.0 - np.exp(-dt / _SMOOTHED_S) if went_on else 1.0
        found, kept = [], {}
        for person, now in zip(people, values, strict=True):
            before = self._before.get(person)
            if before is None or not went_on:
                rate = np.full(len(difference(now, now)), np.nan)
            else:
                raw = difference(now, before[0]) / dt
                # what is new begins with its first difference
                rate = np.where(np.isfinite(before[1]), before[1] + weight * (raw - before[1]), raw)
            kept[person] = now, rate
            found.append(rate)
        self._t_ns, self._before = t_ns, kept
        return np.array(found)


def angle_difference(now: Array, before: Array) -> Array:
    """Of angles (V,) in rad, the shorter way round."""
    return np.asarray((now - before + np.pi) % (2 * np.pi) - np.pi)


def pose_difference(now: Array, before: Array) -> Array:
    """Of poses (P * 7,), wxyz and xyz of each: metres and a rotation vector about the world's axes, (P * 6,)."""
    one, other = now.reshape(-1, 7), before.reshape(-1, 7)
    return np.concatenate([one[:, 4:] - other[:, 4:], small_turn(one[:, :4], other[:, :4])], axis=-1).ravel()


def packed_poses(poses: SE3) -> Array:
    """(N, P * 7) of a batch (N, P), as `pose_difference` takes them."""
    both = np.concatenate([poses.wxyz, poses.xyz], axis=-1)
    return np.asarray(both.reshape(len(both), -1))
