"""Heatmap outputs (ViTPose, HRNet, AlphaPose's FastPose): one small image per keypoint.

Sub-pixel rules: Xiao et al. 2018 (a quarter cell towards the higher neighbour); Zhang et al. 2020, "Distribution-aware coordinate
representation for human pose estimation" (Taylor expansion of the logarithm after a blur).
"""

from __future__ import annotations

import cv2
import numpy as np

from posefuse.core.arrays import Array

from .card import Decoding
from .keypoints import Keypoints, peak_statistics


def keypoints_from_heatmaps(heatmaps: Array, size_wh: tuple[int, int], decoding: Decoding) -> Keypoints:
    """Peak of each heatmap in input px; the score is its height.

    Args:
        heatmaps: (B, K, H, W).
        size_wh: px of the input.
        decoding: its sub-pixel rule, and whether heatmap and input span their outermost pixel centres (udp).
    """
    maps = np.maximum(heatmaps, 0).astype(np.float64)
    batch, count, rows, columns = maps.shape
    flat = maps.reshape(batch, count, -1)
    best = flat.argmax(-1)
    row, column = best // columns, best % columns
    height = np.take_along_axis(flat, best[..., None], -1)[..., 0]
    cells = np.stack([column, row], axis=-1).astype(np.float64) + _offsets(maps, row, column, decoding)
    per_px = _cells_per_px((columns, rows), size_wh, decoding.udp)
    along_x = np.take_along_axis(maps, row[..., None, None], 2)[:, :, 0]
    along_y = np.take_along_axis(maps, column[..., None, None], 3)[..., 0]
    spread_x, rival_x = peak_statistics(along_x, column, per_px[0])
    spread_y, rival_y = peak_statistics(along_y, row, per_px[1])
    there = height > 0
    return Keypoints(
        np.where(there[..., None], cells / per_px, np.nan),
        np.clip(height, 0, 1),
        np.where(there[..., None], np.stack([spread_x, spread_y], axis=-1), np.nan),
        np.where(there, np.maximum(rival_x, rival_y), 0.0),
    )


def _cells_per_px(cells_wh: tuple[int, int], size_wh: tuple[int, int], udp: bool) -> Array:
    cells, size = np.array(cells_wh, np.float64), np.array(size_wh, np.float64)
    return np.asarray((cells - 1) / (size - 1) if udp else cells / size)


def _offsets(maps: Array, row: Array, column: Array, decoding: Decoding) -> Array:
    """(B, K, 2) cells from the highest cell to the peak between cells."""
    if decoding.subpixel == "none":
        return np.zeros((*row.shape, 2))
    inner_row, inner_column = np.clip(row, 1, maps.shape[2] - 2), np.clip(column, 1, maps.shape[3] - 2)
    inside = np.stack([inner_column == column, inner_row == row], axis=-1)
    values = _blurred(maps, decoding.blur_cells) if decoding.subpixel == "dark" else maps
    b, k = np.ogrid[: maps.shape[0], : maps.shape[1]]
    around = np.stack(
        [np.stack([values[b, k, inner_row + i, inner_column + j] for j in (-1, 0, 1)], -1) for i in (-1, 0, 1)], axis=-2
    )
    moved = _quarter(around) if decoding.subpixel == "quarter" else _taylor(around)
    return np.where(inside, moved, 0.0)


def _quarter(around: Array) -> Array:
    right, left = around[..., 1, 2], around[..., 1, 0]
    below, above = around[..., 2, 1], around[..., 0, 1]
    return np.asarray(0.25 * np.sign(np.stack([right - left, below - above], axis=-1)))


def _taylor(around: Array) -> Array:
    """Top (x, y) of the paraboloid through the logarithms of 3 x 3 cells (..., 3, 3), at most a cell away."""
    logs = np.log(np.maximum(around, 1e-10))
    dx, dy = (logs[..., 1, 2] - logs[..., 1, 0]) / 2, (logs[..., 2, 1] - logs[..., 0, 1]) / 2
    dxx = logs[..., 1, 2] - 2 * logs[..., 1, 1] + logs[..., 1, 0]
    dyy = logs[..., 2, 1] - 2 * logs[..., 1, 1] + logs[..., 0, 1]
    dxy = (logs[..., 2, 2] - logs[..., 2, 0] - logs[..., 0, 2] + logs[..., 0, 0]) / 4
    determinant = dxx * dyy - dxy**2
    top = (dxx < 0) & (determinant > 1e-9)
    safe = np.where(top, determinant, 1.0)
    moved = -np.stack([dyy * dx - dxy * dy, dxx * dy - dxy * dx], axis=-1) / safe[..., None]
    return np.clip(np.where(top[..., None], moved, 0.0), -1.0, 1.0)


def _blurred(maps: Array, cells: int) -> Array:
    return np.stack(
        [[cv2.GaussianBlur(one, (cells, cells), 0, borderType=cv2.BORDER_CONSTANT) for one in person] for person in maps]
    )
