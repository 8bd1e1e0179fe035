"""What a stereo depth camera makes of the true depth of every pixel.

Noise acts on the disparity d = f b / z: sigma(z) = z^2 sigma_d / (f b) then is what `core.depth.DepthNoise` states (Khoshelham
and Elberink 2012), and steps of the disparity are steps of depth that grow with distance. Errors of neighbouring pixels are
alike, because the camera matches blocks. Each pixel looks a little off its place (lateral noise of 0.8 px, Nguyen, Izadi and
Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction and tracking", 3DIMPVT 2012), so that outlines are ragged;
next to edges of depth some pixels have no depth, where one of the two lenses does not see the surface.
"""

from __future__ import annotations

import cv2
import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.depth import MM_PER_M, DepthImage, DepthNoise
from posefuse.simulation.depth import DepthSettings

# a jump between neighbours by more than this share of the depth is an edge
_EDGE_SHARE = 0.05


def measured_depth(true_m: Array, settings: DepthSettings, seed: list[int]) -> DepthImage:
    """The depth image of a camera.

    Args:
        true_m: (H, W) depth along the optical axis, m; NaN or beyond `reach_m` where there is none.
        settings: of the camera. seed: numbers the noise is drawn from.
    """
    rng = np.random.default_rng(seed)
    noise = noise_of(settings)
    shape = true_m.shape
    true_m = np.where((true_m > 0) & (true_m <= settings.reach_m), true_m, np.nan).astype(np.float32)
    beside = np.rint(rng.normal(scale=settings.lateral_px, size=(2, *shape))).astype(np.int64)
    rows, columns = np.indices(shape)
    seen_m = true_m[(rows + beside[0]).clip(0, shape[0] - 1), (columns + beside[1]).clip(0, shape[1] - 1)]
    span = noise.focal_px * noise.baseline_m
    disparity = span / seen_m + noise.disparity_sigma_px * _alike(rng, shape, settings.block_px)
    if noise.step_px:
        disparity = np.rint(disparity / noise.step_px) * noise.step_px
    depth_m = span / np.maximum(disparity, 1e-6) + noise.floor_m * rng.standard_normal(shape, np.float32)
    lost = _near_edges(true_m, settings.block_px) & (rng.random(shape) < settings.edge_loss)
    known = np.isfinite(depth_m) & ~lost & (depth_m > 0) & (depth_m <= settings.reach_m)
    return DepthImage(values=np.where(known, np.rint(depth_m * MM_PER_M), 0).astype(np.uint16), noise=noise)


def noise_of(settings: DepthSettings) -> DepthNoise:
    """The noise that such a camera states."""
    return DepthNoise(
        focal_px=settings.focal_px,
        baseline_m=settings.baseline_m,
        disparity_sigma_px=settings.disparity_sigma_px,
        step_px=settings.step_px,
        floor_m=settings.floor_m,
    )


def _alike(rng: np.random.Generator, shape: tuple[int, ...], block_px: float) -> Array:
    """(H, W) normal numbers of variance 1 that are alike within a block."""
    drawn = rng.standard_normal(shape, np.float32)
    if block_px <= 1:
        return drawn
    sigma = block_px / 2
    smooth = cv2.GaussianBlur(drawn, (0, 0), sigma)
    # a Gaussian filter of width sigma leaves 1 / (4 pi sigma^2) of the variance
    return np.asarray(smooth * (2 * np.sqrt(np.pi) * sigma))


def _near_edges(depth_m: Array, block_px: float) -> Array:
    """(H, W) pixels next to a jump of depth."""
    filled = np.nan_to_num(depth_m, nan=0.0)
    kernel = np.ones((2 * max(1, round(block_px / 2)) + 1,) * 2, np.uint8)
    jump = cv2.dilate(filled, kernel) - cv2.erode(filled, kernel)
    return np.asarray(jump > _EDGE_SHARE * np.maximum(filled, 1.0))
