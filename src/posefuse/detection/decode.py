"""Outputs of networks to keypoints in px of their input, and how wide the network's distribution about each is.

SimCC (RTMPose, RTMW, DWPose), one distribution along x and one along y: Li et al. 2022, "SimCC: a Simple Coordinate
Classification Perspective for Human Pose Estimation"; Jiang et al. 2023, "RTMPose".

Heatmaps (ViTPose, HRNet, AlphaPose's FastPose), sub-pixel: Zhang et al. 2020, "Distribution-aware coordinate representation for
human pose estimation" (Taylor expansion of the logarithm after a blur). Landmarks of BlazePose.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posefuse.core.arrays import Array

from .card import Decoding


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Keypoints of B people in px of the network's input, pixel centres at integers.

    Attributes:
        xy: (B, K, 2); NaN where the network gives nothing.
        score: (B, K) in [0, 1]; 0 where it gives nothing.
        spread_px: (B, K, 2) standard deviation of the network's distribution about its peak along x and y; NaN where the
            layout has no distribution.
        rival: (B, K) the highest value away from the peak, as a share of the peak; 0 where the layout has no distribution.
    """

    xy: Array
    score: Array
    spread_px: Array
    rival: Array

    def only(self, i: int) -> Keypoints:
        """Those of one person, B = 1."""
        return Keypoints(*(values[i : i + 1] for values in (self.xy, self.score, self.spread_px, self.rival)))


@dataclass(frozen=True, eq=False)
class People:
    """People in one input: boxes (P, 4) left, top, right, bottom in input px, scores (P,), keypoints of a one-stage network."""

    box: Array
    score: Array
    keypoints: Keypoints | None = None


# of a distribution's length: what is nearer to its peak belongs to it
_WINDOW_SHARE = 0.04


def peak_statistics(values: Array, peak: Array, per_px: float) -> tuple[Array, Array]:
    """Spread (..., ) in input px and rival (...,) of distributions (..., n) about their highest bins (...,).

    The second moment is that of the squared values, whose flanks do not reach over to neighbouring limbs, times the square
    root of two: of a Gaussian that is its standard deviation.

    Args:
        values: >= 0. peak: int. per_px: bins per input px.
    """
    count = values.shape[-1]
    half = max(3, int(np.ceil(_WINDOW_SHARE * count)))
    away = np.arange(count) - peak[..., None]
    near = np.abs(away) <= half
    mass = np.where(near, values, 0.0) ** 2
    total = np.maximum(mass.sum(-1), 1e-12)
    mean = (mass * away).sum(-1) / total
    variance = (mass * (away - mean[..., None]) ** 2).sum(-1) / total
    highest = np.maximum(values.max(-1), 1e-12)
    rival = np.where(near, 0.0, values).max(-1) / highest
    return np.sqrt(2 * variance) / per_px, rival


def parabola_offset(before: Array, at: Array, after: Array) -> Array:
    """Where between -0.5 and 0.5 cells a parabola through the logarithms of three neighbours has its top."""
    low, middle, high = (np.log(np.maximum(value, 1e-10)) for value in (before, at, after))
    bend = low - 2 * middle + high
    safe = np.where(bend < -1e-9, bend, -1.0)
    return np.asarray(np.clip(np.where(bend < -1e-9, 0.5 * (low - high) / safe, 0.0), -0.5, 0.5))


def keypoints_from_simcc(simcc_x: Array, simcc_y: Array, decoding: Decoding) -> Keypoints:
    """Peak of each distribution, in input px; the score is the lower of the two peaks.

    Args:
        simcc_x: (B, K, bins along x). simcc_y: (B, K, bins along y).
        decoding: its split ratio and sub-pixel rule.
    """
    x, spread_x, rival_x, peak_x = _along(np.maximum(simcc_x, 0).astype(np.float64), decoding)
    y, spread_y, rival_y, peak_y = _along(np.maximum(simcc_y, 0).astype(np.float64), decoding)
    xy, spread = np.stack([x, y], axis=-1), np.stack([spread_x, spread_y], axis=-1)
    return _peaks(xy, np.minimum(peak_x, peak_y), spread, np.maximum(rival_x, rival_y))


def _peaks(xy: Array, height: Array, spread_px: Array, rival: Array) -> Keypoints:
    """Keypoints at the peaks of distributions; nothing where the peak has no height (B, K)."""
    there = height > 0
    xy, spread_px = (np.where(there[..., None], values, np.nan) for values in (xy, spread_px))
    return Keypoints(xy, np.clip(height, 0, 1), spread_px, np.where(there, rival, 0.0))


def _along(values: Array, decoding: Decoding) -> tuple[Array, Array, Array, Array]:
    """Position in input px, spread in input px, rival and height of the peak, (B, K) each, of distributions (B, K, n)."""
    peak = values.argmax(-1)
    height = np.take_along_axis(values, peak[..., None], -1)[..., 0]
    spread, rival = peak_statistics(values, peak, decoding.split_ratio)
    smooth = _blurred_along(values, decoding.blur_cells) if decoding.subpixel == "dark" else values
    inner = np.clip(peak, 1, values.shape[-1] - 2)
    at = [np.take_along_axis(smooth, (inner + step)[..., None], -1)[..., 0] for step in (-1, 0, 1)]
    position = peak + np.where(inner == peak, parabola_offset(*at), 0.0)
    return position / decoding.split_ratio, spread, rival, height


def _blurred_along(values: Array, cells: int) -> Array:
    flat = np.ascontiguousarray(values.reshape(-1, values.shape[-1]))
    return np.asarray(cv2.GaussianBlur(flat, (cells, 1), 0, borderType=cv2.BORDER_CONSTANT)).reshape(values.shape)


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
    return _peaks(cells / per_px, height, np.stack([spread_x, spread_y], axis=-1), np.maximum(rival_x, rival_y))


def _cells_per_px(cells_wh: tuple[int, int], size_wh: tuple[int, int], udp: bool) -> Array:
    cells, size = np.array(cells_wh, np.float64), np.array(size_wh, np.float64)
    return np.asarray((cells - 1) / (size - 1) if udp else cells / size)


def _offsets(maps: Array, row: Array, column: Array, decoding: Decoding) -> Array:
    """(B, K, 2) cells from the highest cell to the peak between cells."""
    inner_row, inner_column = np.clip(row, 1, maps.shape[2] - 2), np.clip(column, 1, maps.shape[3] - 2)
    inside = np.stack([inner_column == column, inner_row == row], axis=-1)
    values = _blurred(maps, decoding.blur_cells) if decoding.subpixel == "dark" else maps
    b, k = np.ogrid[: maps.shape[0], : maps.shape[1]]
    around = np.stack(
        [np.stack([values[b, k, inner_row + i, inner_column + j] for j in (-1, 0, 1)], -1) for i in (-1, 0, 1)], axis=-2
    )
    return np.where(inside, _taylor(around), 0.0)


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
