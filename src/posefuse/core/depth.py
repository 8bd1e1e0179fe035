"""Depth that an RGB-D camera adds to what it sees: the image, how noisy it is, and the depth of keypoints.

A depth camera measures the skin or the clothes, a keypoint lies below them: at a joint, about half as deep as the limb is
thick. `keypoint_depth` adds that, with its uncertainty, wherever depth becomes a measurement. Stored values stay
as the camera measured them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from .arrays import Array
from .errors import ShapeError
from .skeleton import Skeleton

MM_PER_M = 1000.0
# (m below the surface, standard deviation) by the part of the body. Nose, eyes, ears and joints down to the toes are the medians
# of 24 views of a rendered body that appears in no reported measurement (seed 8100, `bench/depth.py --fit`), the deviations those
# or more, for other people, clothes and networks; the others are estimates.
_BELOW_M = {
    "nose": (0.008, 0.02), "eye": (0.008, 0.02), "ear": (0.005, 0.03), "mouth": (0.005, 0.02), "head": (0.09, 0.04),
    "neck": (0.06, 0.03), "shoulder": (0.05, 0.02), "elbow": (0.038, 0.012), "wrist": (0.022, 0.012),
    "hip": (0.097, 0.03), "knee": (0.057, 0.015), "ankle": (0.039, 0.015), "heel": (0.026, 0.015), "toe": (0.015, 0.022),
    "foot": (0.015, 0.022), "pinky": (0.015, 0.015), "index": (0.015, 0.015), "thumb": (0.015, 0.015),
    "hand": (0.02, 0.015),
}  # fmt: skip
_ELSEWHERE_M = (0.06, 0.04)


@dataclass(frozen=True, kw_only=True)
class DepthNoise:
    """Random error of a depth camera at a distance: that of stereo, with a floor.

    sigma(z) = sqrt(floor_m^2 + (z^2 disparity_sigma_px / (focal_px baseline_m))^2), the propagation of an error of the
    disparity d = focal_px baseline_m / z to depth. Khoshelham and Elberink, "Accuracy and resolution of Kinect depth data for
    indoor mapping applications" (Sensors 12, 2012) derive it for structured light and find it in measurements; Intel's notes
    on tuning RealSense D400 cameras give the same law with `disparity_sigma_px` below 0.1.

    Attributes:
        focal_px: of the depth imager at the resolution that it matches at. baseline_m: between its two lenses.
        disparity_sigma_px: error of a match. step_px: smallest step of a disparity; 0: no steps.
        floor_m: error that does not grow with distance: alignment to the colour image, interpolation between its pixels.
    """

    focal_px: float = 425.0
    baseline_m: float = 0.05
    disparity_sigma_px: float = 0.08
    step_px: float = 1 / 32
    floor_m: float = 0.003

    def sigma_m(self, depth_m: Array) -> Array:
        """Standard deviation at these depths, of any shape."""
        per_px = np.square(depth_m) / (self.focal_px * self.baseline_m)
        return np.asarray(np.sqrt(self.floor_m**2 + (per_px * self.disparity_sigma_px) ** 2))


@dataclass(frozen=True, eq=False, kw_only=True)
class DepthImage:
    """Depth of every pixel of a colour image, aligned with it.

    Attributes:
        values: (H, W) uint16 depth along the optical axis in units of `unit_m`; 0 where unknown. Not copied.
        unit_m: of the values; cameras count millimetres.
        noise: of the camera.
    """

    values: Array
    unit_m: float = 1 / MM_PER_M
    noise: DepthNoise = DepthNoise()

    def __post_init__(self) -> None:
        if self.values.ndim != 2 or self.values.dtype != np.uint16 or not self.unit_m > 0:
            raise ShapeError(
                f"DepthImage: expected uint16 values (H, W) and unit_m > 0, got {self.values.dtype} {self.values.shape}, "
                f"{self.unit_m}"
            )


class _WithDepth(Protocol):
    @property
    def score(self) -> Array: ...

    @property
    def depth_m(self) -> Array | None: ...


def joined_depth(parts: Sequence[_WithDepth]) -> Array | None:
    """Depths (R, K, 2) of several lists of detections behind each other; None where none of them has any."""
    if all(part.depth_m is None for part in parts):
        return None
    known = [np.full((*part.score.shape, 2), np.nan) if part.depth_m is None else part.depth_m for part in parts]
    return np.concatenate(known)


def keypoint_depth(depth_m: Array, norm: Array, skeleton: Skeleton) -> Array:
    """Depth of the keypoints themselves, from that of the surface in front of them.

    Args:
        depth_m: (..., K, 2) depth of the surface along the optical axis and its standard deviation, m.
        norm: (..., K, 2) the keypoints on the ideal image plane.

    Returns:
        (..., K, 2) the same of the keypoints; NaN where unknown.
    """
    below_m = _below_m(skeleton)
    # the keypoint lies deeper along its ray, not along the optical axis
    slope = np.sqrt(1 + np.square(norm).sum(axis=-1))
    return np.stack([depth_m[..., 0] + below_m[:, 0] / slope, np.hypot(depth_m[..., 1], below_m[:, 1])], axis=-1)


@lru_cache(maxsize=16)
def _below_m(skeleton: Skeleton) -> Array:
    """(K, 2) how far each keypoint lies below the surface, and the standard deviation."""
    return np.array([_part_below_m(name) for name in skeleton.keypoints])


def _part_below_m(keypoint: str) -> tuple[float, float]:
    return next((below for part, below in _BELOW_M.items() if part in keypoint), _ELSEWHERE_M)
