"""Which parts of the images a target has covered: to judge a calibration, and to guide the hand while it records."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.sparse.csgraph import connected_components

from posefuse.core.arrays import Array, freeze_fields

from .corners import CornerObservations

CELLS_WH = (8, 6)
# free-running cameras show the same moment within this time
SAME_MOMENT_NS = 60_000_000
# every camera of examples/scenes/calibration_cube_8cam.yaml, which comes out to 2 mm, covers more than this
ENOUGH_SHARE, ENOUGH_TOGETHER = 0.25, 30
_FULL_COUNT = 12
_COLOUR_LOW, _COLOUR_FULL = np.array([200, 60, 40]), np.array([40, 170, 80])


@dataclass(frozen=True, eq=False)
class TargetCoverage:
    """Frames in which each cell of each camera's image held a corner of the target.

    Attributes:
        cameras: names. cells: (C, rows, columns) counts.
        together: (C, C) moments at which two cameras saw the target at once; the diagonal counts the frames of one camera.
    """

    cameras: tuple[str, ...]
    cells: Array
    together: Array

    def __post_init__(self) -> None:
        freeze_fields(self, {"cells": np.int64, "together": np.int64})

    @property
    def share(self) -> Array:
        """(C,) share of each image that the target has met."""
        return np.asarray((self.cells > 0).mean(axis=(1, 2)))

    @property
    def enough(self) -> bool:
        """Every camera has met the target in much of its image, and all are linked by many moments."""
        return len(linked_groups(self.together >= ENOUGH_TOGETHER)) == 1 and bool((self.share >= ENOUGH_SHARE).all())

    def advice(self, needed: float = ENOUGH_SHARE) -> str:
        """What to do next, in words; `needed`: share of each image to be met."""
        if self.enough and (self.share >= needed).all():
            return "enough: stop moving the target and calibrate"
        hidden = [name for name, n in zip(self.cameras, np.diag(self.together), strict=True) if n == 0]
        if hidden:
            return f"show the target to {', '.join(hidden)}"
        groups = linked_groups(self.together >= ENOUGH_TOGETHER)
        if len(groups) > 1:
            first, second = ("one of " * (len(group) > 1) + ", ".join(self.cameras[i] for i in group) for group in groups[:2])
            return f"show the target to {first} and to {second} at the same time"
        poorest = int(np.argmin(self.share))
        row, column = np.unravel_index(np.argmin(self.cells[poorest]), self.cells[poorest].shape)
        height = ("top", "middle", "bottom")[int(3 * row / self.cells.shape[1])]
        side = ("left", "centre", "right")[int(3 * column / self.cells.shape[2])]
        return (
            f"{self.cameras[poorest]}: {self.share[poorest]:.0%} covered, {needed:.0%} needed; go to the {height} {side} of"
            " its image"
        )


def cell_of(xy_img: Array, size_wh: Array | tuple[int, int]) -> Array:
    """(N, 2) column and row of the cell in which each point (N, 2) px lies, of one image size or of one each."""
    return np.clip(((xy_img + 0.5) / size_wh * CELLS_WH).astype(np.int64), 0, np.array(CELLS_WH) - 1)


def linked_groups(linked: Array) -> list[list[int]]:
    """Connected groups of the symmetric relation (n, n), largest first, then by first member."""
    count, label = connected_components(linked, directed=False)
    groups = [np.flatnonzero(label == i).tolist() for i in range(count)]
    return sorted(groups, key=lambda group: (-len(group), group[0]))


def coverage_picture(cells: Array, size_wh: tuple[int, int], image: Array | None = None) -> Array:
    """RGB image (H, W, 3) of one camera's cells (rows, columns) over its image (or over grey): red poor, green rich."""
    width, height = size_wh
    base = np.full((height, width, 3), 96, np.uint8) if image is None else image
    level = np.clip(cells / _FULL_COUNT, 0, 1)[..., None]
    colours = (_COLOUR_LOW * (1 - level) + _COLOUR_FULL * level).astype(np.uint8)
    over = cv2.resize(colours, (width, height), interpolation=cv2.INTER_NEAREST)
    mixed = cv2.addWeighted(base, 0.6, over, 0.4, 0)
    for i in range(1, cells.shape[1]):
        cv2.line(mixed, (i * width // cells.shape[1], 0), (i * width // cells.shape[1], height), (255, 255, 255), 1)
    for i in range(1, cells.shape[0]):
        cv2.line(mixed, (0, i * height // cells.shape[0]), (width, i * height // cells.shape[0]), (255, 255, 255), 1)
    return np.asarray(mixed)


# before the first frame; times may be negative, and differences of two must not overflow
_NEVER_NS = -(2**61)


@dataclass(frozen=True, eq=False)
class Guidance:
    """What has been seen.

    Attributes:
        coverage: frames per image region, and moments per pair of cameras.
        last_ns: (C,) when each camera saw the target last; `_NEVER_NS` before the first time.
        shared_ns: (C, C) newest frame of either of two cameras that was counted as a moment of both.
    """

    coverage: TargetCoverage
    last_ns: Array
    shared_ns: Array


def new_guidance(cameras: tuple[str, ...]) -> Guidance:
    """Nothing seen yet."""
    count, (columns, rows) = len(cameras), CELLS_WH
    nothing = TargetCoverage(cameras, np.zeros((count, rows, columns)), np.zeros((count, count)))
    return Guidance(nothing, np.full(count, _NEVER_NS), np.full((count, count), _NEVER_NS))


def seen(guidance: Guidance, camera: int, t_ns: int, xy_img: Array, size_wh: tuple[int, int]) -> Guidance:
    """With one more frame of camera number `camera`, which shows corners (n, 2) px; n = 0 changes nothing."""
    if len(xy_img) == 0:
        return guidance
    cells, together = guidance.coverage.cells.copy(), guidance.coverage.together.copy()
    column, row = np.unique(cell_of(xy_img, size_wh), axis=0).T
    cells[camera, row, column] += 1
    last, shared = guidance.last_ns.copy(), guidance.shared_ns.copy()
    # a frame pairs with one frame of another camera, not with that before and that after it
    others = (np.abs(last - t_ns) <= SAME_MOMENT_NS) & (np.minimum(last, t_ns) > shared[camera])
    others[camera] = False
    together[camera, camera] += 1
    together[camera, others] += 1
    together[others, camera] += 1
    shared[camera, others] = shared[others, camera] = np.maximum(last[others], t_ns)
    last[camera] = t_ns
    return replace(guidance, coverage=TargetCoverage(guidance.coverage.cameras, cells, together), last_ns=last, shared_ns=shared)


def coverage(observations: CornerObservations) -> TargetCoverage:
    """Coverage of all observations, frame after frame."""
    camera, t_ns, guidance = observations.camera, observations.t_ns, new_guidance(observations.cameras)
    frames = np.split(np.arange(len(camera)), np.flatnonzero((np.diff(camera) != 0) | (np.diff(t_ns) != 0)) + 1)
    for rows in sorted((rows for rows in frames if len(rows)), key=lambda rows: int(t_ns[rows[0]])):
        c = int(camera[rows[0]])
        guidance = seen(guidance, c, int(t_ns[rows[0]]), observations.xy_img[rows], observations.sizes_wh[c])
    return guidance.coverage
