"""The weights of the paper, per camera and keypoint (METHOD section 2)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from posefuse.core import Rig, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import pick_keypoints

from .settings import FuseSettings

# Body segments of the paper and how squarely each camera sees them (the weight w_o).
#
# Segment Z axes run along the bone, proximally: forearm wrist -> elbow, upper arm elbow -> shoulder, shank ankle -> knee,
# thigh knee -> hip, trunk pelvis centre -> neck. Each keypoint belongs to one segment, see `SEGMENT_OF`: a joint to the
# segment that ends in it distally (wrist and hand to the forearm, elbow to the upper arm, ankle and foot to the shank,
# knee to the thigh); shoulders, hips, neck and mid-hip to the trunk. Face and head keypoints belong to none: a head is
# round, w_o = 1.

_SIDES = ("left", "right")
_LIMBS = {"forearm": ("wrist", "elbow"), "upper_arm": ("elbow", "shoulder"), "shank": ("ankle", "knee"), "thigh": ("knee", "hip")}

# segment -> (where its Z axis starts, where it points)
SEGMENTS: dict[str, tuple[str, str]] = {"trunk": ("mid_hip", "neck")} | {
    f"{side}_{limb}": (f"{side}_{start}", f"{side}_{end}") for side in _SIDES for limb, (start, end) in _LIMBS.items()
}

_MEMBERS = {
    "forearm": ("wrist", "pinky", "index", "thumb"),
    "upper_arm": ("elbow",),
    "shank": ("ankle", "heel", "foot_index", "big_toe", "small_toe"),
    "thigh": ("knee",),
}

# keypoint -> segment
SEGMENT_OF: dict[str, str] = dict.fromkeys(
    ("neck", "mid_hip", "left_shoulder", "right_shoulder", "left_hip", "right_hip"), "trunk"
) | {f"{side}_{member}": f"{side}_{limb}" for side in _SIDES for limb, members in _MEMBERS.items() for member in members}


@lru_cache(maxsize=16)
def _segment_index(skeleton: Skeleton) -> Array:
    names = list(SEGMENTS)
    return np.array([names.index(SEGMENT_OF[k]) if k in SEGMENT_OF else -1 for k in skeleton.keypoints])


def side_view(rig: Rig, skeleton: Skeleton, xyz_world: Array) -> Array:
    """The orthogonality index w_o = 1 - |o . z| of METHOD, (..., C, K), from a pose (..., K, 3).

    o is the camera's optical axis, z the Z axis of the keypoint's segment. 1 where the keypoint belongs to no segment;
    NaN where its segment is missing in the pose.
    """
    starts, ends = zip(*SEGMENTS.values(), strict=True)
    along = pick_keypoints(xyz_world, skeleton, ends) - pick_keypoints(xyz_world, skeleton, starts)
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    axes = along / np.where(length > 1e-6, length, np.nan)
    optical = np.stack([camera.cam_from_world.matrix()[2] for camera in rig])
    seen = 1 - np.abs(np.einsum("ci,...si->...cs", optical, axes))
    index = _segment_index(skeleton)
    return np.asarray(np.where(index >= 0, seen[..., index], 1.0))


def score_weight(score: Array, settings: FuseSettings) -> Array:
    """w_s = score^2, and 0 below the threshold."""
    return np.where(score >= settings.score_threshold, score * score, 0.0)


def distance_weight(distance_m: Array, settings: FuseSettings) -> Array:
    """w_d: 1 between distance_min_m and distance_max_m, falling linearly to 0 over distance_fall_m outside."""
    near = (distance_m - settings.distance_min_m) / settings.distance_fall_m + 1
    far = (settings.distance_max_m - distance_m) / settings.distance_fall_m + 1
    return np.clip(np.minimum(near, far), 0.0, 1.0)


def full_weight(rig: Rig, skeleton: Skeleton, score: Array, xyz_world: Array, settings: FuseSettings) -> Array:
    """w = w_s (w_o + w_d) / 2, (..., C, K), about a pose (..., K, 3); w_s alone where the pose is missing."""
    distance = np.linalg.norm(xyz_world[..., None, :, :] - rig.centres_world()[:, None, :], axis=-1)
    w_d = distance_weight(distance, settings)
    w_o = side_view(rig, skeleton, xyz_world)
    placed = (np.where(np.isnan(w_o), w_d, w_o) + w_d) / 2
    return score_weight(score, settings) * np.where(np.isnan(placed), 1.0, placed)
