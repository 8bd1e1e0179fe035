"""How far the cameras' clocks are apart, before anything is known of where the cameras are.

Every camera sees the prop on a path; two cameras' paths are one rigid motion apart only when they are read at the same
moments, so the offset sought is the one at which the best rigid fit (Kabsch 1976, robustly re-weighted) leaves least.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from posefuse.calibration.clocks.start import STEP_S, EvenTrack, agreed_clocks
from posefuse.calibration.solving.projection import Lenses
from posefuse.calibration.solving.rotations import nearest_rotation
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Target, patch_corners
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .bootstrap import prop_views, shape_of
from .planar import planar_views
from .snapshots import snapshots

# two cameras' clocks may be so far apart
MOST_OFFSET_S = 2.0
_WINDOWS, _WINDOW_S = 4, 10.0


def rough_offsets(observations: CornerObservations, cameras: tuple[Camera, ...], target: Target) -> Array:
    """(C,) offset of each camera's clock in s against the first one that is linked, to about half a step of the search.

    NaN for cameras whose path overlaps with none of the others.
    """
    paths = _paths(observations, cameras, target)

    def misfit_m(a: int, b: int) -> Callable[[Array, Array], float]:
        return lambda rows_a, rows_b: _misfit_m(paths[a].xy[rows_a, 0], paths[b].xy[rows_b, 0])

    return agreed_clocks(paths, misfit_m, MOST_OFFSET_S).offset_s


def _paths(observations: CornerObservations, cameras: tuple[Camera, ...], target: Target) -> list[EvenTrack]:
    """Places of the prop in each camera's axes in m, in a few windows of the recording."""
    first = int(observations.t_ns.min())
    step, window = round(STEP_S * 1e9), round(_WINDOW_S / STEP_S)
    count = int(observations.t_ns.max() - first) // step + 1
    begins = np.linspace(0, max(count - window, 0), _WINDOWS).astype(np.int64)
    steps = np.unique(np.add.outer(begins, np.arange(window)).clip(0, count - 1))
    seen = snapshots(observations, first + steps * step, np.zeros((len(cameras), 2)))
    corners, lenses = patch_corners(target, seen.patches), Lenses(cameras)
    planar = planar_views(seen, corners, lenses)
    views = prop_views(seen, planar, shape_of(target, seen, planar), corners, lenses)
    xyz = np.full((len(cameras), count, 1, 3), np.nan)
    xyz[views.camera, steps[views.time_step], 0] = views.cam_from_prop.t[:, 0]
    return [EvenTrack(0, one) for one in xyz]


def _misfit_m(a: Array, b: Array) -> float:
    """Robust spread in m left between places a (n, 3) and b (n, 3) moved rigidly onto them."""
    weight = np.ones(len(a))
    for _ in range(4):
        off = np.linalg.norm(a - _fitted(a, b, weight), axis=1)
        scale = max(float(np.median(off)), 1e-6)
        weight = 1 / (1 + (off / scale) ** 2)
    return float(np.sqrt((weight * off**2).sum() / weight.sum()))


def _fitted(a: Array, b: Array, weight: Array) -> Array:
    """Points b (n, 3) moved rigidly onto a (n, 3)."""
    total = weight.sum()
    middle_a, middle_b = weight @ a / total, weight @ b / total
    rotation = nearest_rotation((weight[:, None] * (a - middle_a)).T @ (b - middle_b))
    return np.asarray((b - middle_b) @ rotation.T + middle_a)
