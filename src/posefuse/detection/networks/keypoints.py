"""What every layout is decoded to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array


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
