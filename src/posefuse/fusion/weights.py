"""The weights of the paper, per camera and keypoint (METHOD section 2)."""

from __future__ import annotations

import numpy as np

from posefuse.core import Rig, Skeleton
from posefuse.core.arrays import Array

from .segments import side_view
from .settings import FuseSettings


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
