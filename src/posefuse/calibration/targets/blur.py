"""How wide the edges of what moves in an image are: images that are out of focus, or exposed for too long."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from posefuse.core.arrays import Array

# a step in focus is 2 to 4 px wide; one that is wider than this is out of focus, or moved during the exposure
BLURRED_EDGE_PX = 6.0
_DIRECTIONS = np.stack([np.cos(np.arange(8) * np.pi / 8), np.sin(np.arange(8) * np.pi / 8)])
_MOVED_GREY, _LEAST_MOVING_PX, _AROUND_PX = 12, 400, 9
_PERCENTILE, _PERCENTILE_ALL = 99.8, 99.95
_EVERY, _MOST = 4, 40


def moving_pixels(before: Array, image: Array, after: Array) -> Array:
    """(H, W) bool: what differs from both the image before and the image after (three-frame difference)."""
    changed = cv2.min(cv2.absdiff(image, before), cv2.absdiff(image, after)) > _MOVED_GREY
    return np.asarray(cv2.dilate(changed.astype(np.uint8), np.ones((_AROUND_PX, _AROUND_PX), np.uint8)) > 0)


def edge_width_px(grey: Array, where: Array | None = None) -> float:
    """Contrast over the steepest edge, in the direction in which edges are widest; NaN where there is little to look at.

    Motion keeps the edges along it sharp, so edges of every direction are looked at. `where` (H, W) bool: only there.
    """
    percentile = _PERCENTILE_ALL if where is None else _PERCENTILE
    if where is None:
        where = np.ones(grey.shape, bool)
    if np.count_nonzero(where) < _LEAST_MOVING_PX:
        return float("nan")
    rows, columns = (np.flatnonzero(where.any(axis=axis)) for axis in (1, 0))
    box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    image, inside = cv2.GaussianBlur(grey[box].astype(np.float32), (0, 0), 1.0), where[box]
    gradient = [cv2.Sobel(image, cv2.CV_32F, *order, scale=1 / 8)[inside] for order in ((1, 0), (0, 1))]
    steepest = np.percentile(np.abs(np.stack(gradient, axis=1) @ _DIRECTIONS), percentile, axis=0)
    low, high = np.percentile(image[inside], [0.5, 99.5])
    return float((high - low) / max(float(steepest.min()), 1e-3))


def usual_edge_width_px(images: Sequence[Array]) -> float:
    """Median over consecutive grey images of the width of moving edges; of all edges where nothing moves."""
    moving = MovingEdges(every=1)
    for image in images:
        moving.add(image)
    return moving.width_px if moving.widths_px else float(np.median([edge_width_px(image) for image in images] or [np.nan]))


class MovingEdges:
    """Width of the edges of what moves, over the frames of one camera as they come; a sample of them is measured."""

    def __init__(self, every: int = _EVERY) -> None:
        self.widths_px: list[float] = []
        self._every, self._count, self._last = every, 0, list[Array]()

    def add(self, grey: Array) -> None:
        """The next frame."""
        self._last = [*self._last[-2:], grey]
        self._count += 1
        if len(self._last) == 3 and self._count % self._every == 0 and len(self.widths_px) < _MOST:
            width = edge_width_px(self._last[1], moving_pixels(*self._last))
            self.widths_px += [width] if np.isfinite(width) else []

    @property
    def width_px(self) -> float:
        """Median; NaN where nothing moved."""
        return float(np.median(self.widths_px)) if self.widths_px else float("nan")
