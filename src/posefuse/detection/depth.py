"""Depth of keypoints from a depth image: the depth of the surface in a small window about each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.core import Detections2D
from posefuse.core.arrays import SIGMA_PER_MAD, Array
from posefuse.core.depth import DepthImage

# half a window is about 2 cm at the person, whose keypoints extend over some 1.6 m
_WINDOWS_PER_BODY = 80.0
_LEAST_HALF_PX, _MOST_HALF_PX = 1, 8
# the surface is the nearest that takes a quarter of the window: next to a thin limb the rest is what lies behind it
_NEAR_SHARE = 0.25
# of that surface, from its near edge on
_THICK_M = 0.05
# pixels of a window whose depth must be known, as a share
_LEAST_KNOWN = 0.3
# a keypoint with a lower score is often hidden: the surface is then that of the occluder, often the person's own body
_LEAST_SCORE = 0.5
# no keypoint is further from the middle of its body along the optical axis
_REACH_M = 1.0


def with_depth(detections: Detections2D, depth: DepthImage | None) -> Detections2D:
    """The same people with the depth of the surface at each keypoint; unchanged where there is no depth image.

    What stands in front of a person is not recognised here: fusion and tracking treat such a depth as an outlier. Keypoints that
    the network is not sure of have no depth.

    Args:
        detections: of one frame. depth: of that frame.
    """
    if depth is None:
        return detections
    if not len(detections):
        return replace(detections, depth_m=np.zeros((*detections.score.shape, 2)))
    found = np.stack([_of_person(xy, score, depth) for xy, score in zip(detections.xy_img, detections.score, strict=True)])
    return replace(detections, depth_m=found)


def _of_person(xy_img: Array, score: Array, depth: DepthImage) -> Array:
    """(K, 2) depth and standard deviation of one person's keypoints (K, 2); NaN where unknown."""
    found = np.full((len(xy_img), 2), np.nan)
    somewhere = (score > 0) & np.isfinite(xy_img).all(axis=-1)
    seen = np.flatnonzero(somewhere & (score >= _LEAST_SCORE))
    if not len(seen):
        return found
    extent_px = np.ptp(xy_img[somewhere], axis=0).max()
    half = int(np.clip(round(float(extent_px) / _WINDOWS_PER_BODY), _LEAST_HALF_PX, _MOST_HALF_PX))
    windows_m = _windows(depth, np.rint(xy_img[seen]).astype(np.int64), half)
    surface_m, spread_m = _near_surface(windows_m)
    known = np.flatnonzero(np.isfinite(surface_m))
    if len(known):
        known = known[np.abs(surface_m[known] - np.median(surface_m[known])) <= _REACH_M]
    found[seen[known], 0] = surface_m[known]
    found[seen[known], 1] = np.hypot(depth.noise.sigma_m(surface_m[known]), spread_m[known])
    return found


def _windows(depth: DepthImage, at: Array, half: int) -> Array:
    """(n, W * W) depths in square windows about pixels (n, 2); NaN where unknown or outside the image."""
    height, width = depth.values.shape
    step = np.arange(-half, half + 1)
    column, row = at[:, 0, None, None] + step, at[:, 1, None, None] + step[:, None]
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    raw = depth.values[row.clip(0, height - 1), column.clip(0, width - 1)]
    return np.where(inside & (raw > 0), raw * depth.unit_m, np.nan).reshape(len(at), -1)


def _near_surface(windows_m: Array) -> tuple[Array, Array]:
    """(n,) median depth of the nearest surface in each window (n, W * W), and how much it varies."""
    known = np.isfinite(windows_m).sum(axis=1)
    ordered = np.sort(windows_m, axis=1)  # NaN last
    near = ordered[np.arange(len(ordered)), (known * _NEAR_SHARE).astype(np.int64).clip(max=ordered.shape[1] - 1)]
    surface = np.where(np.abs(windows_m - near[:, None]) <= _THICK_M, windows_m, np.nan)
    usable = known >= _LEAST_KNOWN * windows_m.shape[1]
    middle, spread = np.full(len(windows_m), np.nan), np.full(len(windows_m), np.nan)
    if usable.any():
        middle[usable] = np.nanmedian(surface[usable], axis=1)
        spread[usable] = SIGMA_PER_MAD * np.nanmedian(np.abs(surface[usable] - middle[usable, None]), axis=1)
    return middle, spread
