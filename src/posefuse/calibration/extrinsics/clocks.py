"""How far the cameras' clocks are apart, before anything is known of where the cameras are.

Every camera sees the prop on a path; two cameras' paths are one rigid motion apart only when they are read at the same
moments, so the offset sought is the one at which the best rigid fit (Kabsch 1976, robustly re-weighted) leaves least.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from posefuse.calibration.solving.projection import Lenses
from posefuse.calibration.solving.rotations import nearest_rotation
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Target, patch_corners
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .bootstrap import prop_views
from .planar import planar_views
from .prop_shape import shape_of
from .snapshots import snapshots

_WINDOWS, _WINDOW_S, _RATE_HZ = 4, 10.0, 30.0
_LONGEST_GAP_S = 0.1
_LEAST_SHARED = 30
_STEP_S, _COARSE_STEP_S = 0.01, 0.05


def rough_offsets(observations: CornerObservations, cameras: tuple[Camera, ...], target: Target, most_s: float) -> Array:
    """(C,) offset of each camera's clock in s against the first camera's group, to about a third of a frame.

    NaN for cameras whose path overlaps with none of the others.
    """
    count = len(cameras)
    edges: list[tuple[float, int, int, float]] = []
    paths = _paths(observations, cameras, target)
    for a in range(count):
        for b in range(a + 1, count):
            found = _pair_offset(paths[a], paths[b], most_s)
            if found is not None:
                edges.append((found[1], a, b, found[0]))
    offset = np.full(count, np.nan)
    if not edges:
        return offset
    offset[max(edges)[1]] = 0.0
    while True:
        front = [e for e in edges if np.isfinite(offset[e[1]]) != np.isfinite(offset[e[2]])]
        if not front:
            return offset
        _, a, b, late = max(front)
        if np.isfinite(offset[a]):
            offset[b] = offset[a] + late
        else:
            offset[a] = offset[b] - late


def _paths(observations: CornerObservations, cameras: tuple[Camera, ...], target: Target) -> list[tuple[Array, Array]]:
    """Per camera: times (n,) s and places of the prop in camera axes (n, 3) m, in a few windows of the recording."""
    first, last = int(observations.t_ns.min()), int(observations.t_ns.max())
    step = round(1e9 / _RATE_HZ)
    span, window = last - first, round(_WINDOW_S * 1e9)
    if span <= _WINDOWS * window:
        instants = np.arange(first, last + 1, step)
    else:
        begins = np.linspace(first, last - window, _WINDOWS).astype(np.int64)
        instants = np.concatenate([np.arange(begin, begin + window, step) for begin in begins])
    seen = snapshots(observations, instants, np.zeros((len(cameras), 2)))
    corners, lenses = patch_corners(target, seen.patches), Lenses(cameras)
    planar = planar_views(seen, corners, lenses)
    views = prop_views(seen, planar, shape_of(target, seen, planar), corners, lenses)
    return [
        (seen.t_s[views.instant[mine]], views.cam_from_prop.t[mine, 0])
        for mine in views.camera == np.arange(len(cameras))[:, None]
    ]


def _pair_offset(path_a: tuple[Array, Array], path_b: tuple[Array, Array], most_s: float) -> tuple[float, float] | None:
    """How much later b's stamps are than a's, and how sharply that is determined; None without enough overlap."""
    coarse = np.arange(-most_s, most_s + _COARSE_STEP_S / 2, _COARSE_STEP_S)
    overall = np.array([_misfit(path_a, path_b, late) for late in coarse])
    if not np.isfinite(overall).any():
        return None
    # a hand takes far longer than a coarse step to turn back, so the best fine step is near the best coarse one
    near = float(coarse[int(np.nanargmin(overall))])
    trials = np.arange(near - _COARSE_STEP_S, near + _COARSE_STEP_S + _STEP_S / 2, _STEP_S)
    trials = trials[np.abs(trials) <= most_s + _STEP_S / 2]
    left = np.array([_misfit(path_a, path_b, late) for late in trials])
    best = int(np.nanargmin(left))
    low, high = trials[max(best - 1, 0)], trials[min(best + 1, len(trials) - 1)]
    refined = minimize_scalar(lambda late: _misfit(path_a, path_b, late), bounds=(low, high), method="bounded")
    sharpness = float(np.nanmedian(overall) / max(np.nanmin(left), 1e-9))
    return (float(refined.x) if np.isfinite(refined.fun) else float(trials[best])), sharpness


def _misfit(path_a: tuple[Array, Array], path_b: tuple[Array, Array], late_s: float) -> float:
    """Robust spread in m left between two paths when b is read `late_s` later."""
    wanted = path_a[0] + late_s
    after = np.clip(np.searchsorted(path_b[0], wanted), 1, max(len(path_b[0]) - 1, 1))
    if len(path_b[0]) < 2:
        return float("nan")
    t0, t1 = path_b[0][after - 1], path_b[0][after]
    inside = (t0 <= wanted) & (wanted <= t1) & (t1 - t0 <= _LONGEST_GAP_S)
    if inside.sum() < _LEAST_SHARED:
        return float("nan")
    share = ((wanted - t0) / (t1 - t0))[inside, None]
    b = (1 - share) * path_b[1][after - 1][inside] + share * path_b[1][after][inside]
    a = path_a[1][inside]
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
