"""SimCC outputs (RTMPose, RTMW, DWPose): one distribution along x and one along y per keypoint.

Li et al. 2022, "SimCC: a Simple Coordinate Classification Perspective for Human Pose Estimation"; Jiang et al. 2023, "RTMPose".
"""

from __future__ import annotations

import cv2
import numpy as np

from posefuse.core.arrays import Array

from .card import Decoding
from .keypoints import Keypoints, parabola_offset, peak_statistics


def keypoints_from_simcc(simcc_x: Array, simcc_y: Array, decoding: Decoding) -> Keypoints:
    """Peak of each distribution, in input px; the score is the lower of the two peaks.

    Args:
        simcc_x: (B, K, bins along x). simcc_y: (B, K, bins along y).
        decoding: its split ratio and sub-pixel rule.
    """
    x, spread_x, rival_x, peak_x = _along(np.maximum(simcc_x, 0).astype(np.float64), decoding)
    y, spread_y, rival_y, peak_y = _along(np.maximum(simcc_y, 0).astype(np.float64), decoding)
    score = np.clip(np.minimum(peak_x, peak_y), 0, 1)
    there = score > 0
    return Keypoints(
        np.where(there[..., None], np.stack([x, y], axis=-1), np.nan),
        score,
        np.where(there[..., None], np.stack([spread_x, spread_y], axis=-1), np.nan),
        np.where(there, np.maximum(rival_x, rival_y), 0.0),
    )


def _along(values: Array, decoding: Decoding) -> tuple[Array, Array, Array, Array]:
    """Position in input px, spread in input px, rival and height of the peak, (B, K) each, of distributions (B, K, n)."""
    peak = values.argmax(-1)
    height = np.take_along_axis(values, peak[..., None], -1)[..., 0]
    spread, rival = peak_statistics(values, peak, decoding.split_ratio)
    position = peak.astype(np.float64)
    if decoding.subpixel != "none":
        smooth = _blurred(values, decoding.blur_cells) if decoding.subpixel == "dark" else values
        inner = np.clip(peak, 1, values.shape[-1] - 2)
        at = [np.take_along_axis(smooth, (inner + step)[..., None], -1)[..., 0] for step in (-1, 0, 1)]
        position += np.where(inner == peak, parabola_offset(*at), 0.0)
    return position / decoding.split_ratio, spread, rival, height


def _blurred(values: Array, cells: int) -> Array:
    flat = np.ascontiguousarray(values.reshape(-1, values.shape[-1]))
    return np.asarray(cv2.GaussianBlur(flat, (cells, 1), 0, borderType=cv2.BORDER_CONSTANT)).reshape(values.shape)
