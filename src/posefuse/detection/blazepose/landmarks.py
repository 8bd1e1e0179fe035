"""Outputs of the landmark network to keypoints in the crop, and their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array

_VALUES = 5  # x, y, z, visibility logit, presence logit
_WINDOW_CELLS = 4  # on either side of the regressed point
_LEAST_PEAK = 0.2


@dataclass(frozen=True, eq=False, kw_only=True)
class Landmarks:
    """Keypoints of B crops.

    Attributes:
        presence: (B,) probability that the crop holds a person.
        xy_crop: (B, K, 2) crop px, pixel centres at integers.
        visibility: (B, K) probability that a keypoint is inside and not hidden.
        peak: (B, K) highest heatmap value near it.
        spread_px: (B, K) standard deviation of the heatmap's mass near it, per axis.
        shift_px: (B, K) distance from the regressed point to the heatmap's centre of mass.
    """

    presence: Array
    xy_crop: Array
    visibility: Array
    peak: Array
    spread_px: Array
    shift_px: Array


def landmarks_from_outputs(landmarks: Array, presence: Array, heatmaps: Array, count: int, side_px: int) -> Landmarks:
    """Decode `count` keypoints, each moved to the centre of mass of its heatmap near the regressed point.

    Args:
        landmarks: (B, channels * 5). presence: (B, 1). heatmaps: (B, H, W, channels) logits.
        count: K, the first channels.
        side_px: of the crop.
    """
    batch, cells = heatmaps.shape[:2]
    cell_px = side_px / cells
    values = landmarks.reshape(batch, -1, _VALUES)[:, :count].astype(np.float64)
    regressed = values[..., :2] / cell_px
    step = np.arange(-_WINDOW_CELLS, _WINDOW_CELLS + 1)
    at = np.rint(regressed).astype(int)[..., None] + step
    inside = (at >= 0) & (at < cells)
    at = np.clip(at, 0, cells - 1)
    frame = np.arange(batch)[:, None, None, None]
    channel = np.arange(count)[None, :, None, None]
    logits = heatmaps[frame, at[:, :, 1, :, None], at[:, :, 0, None, :], channel]
    value = _sigmoid(logits) * (inside[:, :, 1, :, None] & inside[:, :, 0, None, :])
    # squared: the flanks of a broad heatmap reach over to neighbouring limbs
    mass = value**2
    total = mass.sum((2, 3))
    x, y = at[:, :, 0].astype(np.float64), at[:, :, 1].astype(np.float64)
    along_x, along_y = mass.sum(2), mass.sum(3)
    safe = np.maximum(total, 1e-9)
    centre = np.stack([(along_x * x).sum(-1), (along_y * y).sum(-1)], axis=-1) / safe[..., None]
    variance = (along_x * (x - centre[..., :1]) ** 2).sum(-1) + (along_y * (y - centre[..., 1:]) ** 2).sum(-1)
    peak = value.max((2, 3))
    refined = np.where((peak >= _LEAST_PEAK)[..., None], centre, regressed)
    return Landmarks(
        presence=presence.reshape(batch).astype(np.float64),
        # the network draws a keypoint at crop coordinate 4 i (from the crop's corner) into cell i, not between cells:
        # otherwise crops and their mirror images disagree by one cell
        xy_crop=refined * cell_px - 0.5,
        visibility=_sigmoid(values[..., 3]),
        peak=peak,
        spread_px=np.sqrt(variance / safe / 2) * cell_px,
        shift_px=np.linalg.norm(centre - regressed, axis=-1) * cell_px,
    )


def _sigmoid(x: Array) -> Array:
    return np.asarray(1 / (1 + np.exp(-np.clip(x, -60.0, 60.0))))
