"""Left and right exchanged in a view: found by what fits the other views, and put right.

Estimators confuse sides of a limb, or of the whole body, in single views. Such a view is wrong in a known way, so it is
exchanged back rather than thrown away.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from posefuse.core import Rig, Skeleton
from posefuse.core.arrays import Array

from .packed import packed_rig
from .settings import FuseSettings
from .triangulate import Triangulated, solve_robust

# an exchange must win by this much robust loss: two clear outliers' worth, so noise never exchanges
_GAIN = 24.0
# share of a limb's keypoints in a view that must misfit before it is looked at, and fit once exchanged
_MISFIT, _FIT = 0.3, 0.3
_LEGS = ("hip", "knee", "ankle", "heel", "foot_index", "big_toe", "small_toe")
_ARMS = ("shoulder", "elbow", "wrist", "pinky", "index", "thumb")


@lru_cache(maxsize=16)
def limb_groups(skeleton: Skeleton) -> tuple[Array, ...]:
    """Keypoint indices of what may be exchanged together: the whole body, arms, legs, head; sided keypoints only."""
    sided = [k for i, k in enumerate(skeleton.keypoints) if skeleton.mirror[i] != i]
    parts = {k: k.split("_", 1)[1] for k in sided}
    arms = [k for k in sided if parts[k] in _ARMS]
    legs = [k for k in sided if parts[k] in _LEGS]
    head = [k for k in sided if k not in arms and k not in legs]
    return tuple(skeleton.indices(group) for group in (sided, arms, legs, head) if group)


def solve_untangled(
    rig: Rig, xy: Array, score: Array, sigma: Array, skeleton: Skeleton, before: Array | None, settings: FuseSettings
) -> Triangulated:
    """Robust fusion of groups (G, C, K, ...) with views put right side out; `xy`, `score` and `sigma` are exchanged in place.

    `before` (G, K, 3) decides when as many views say one thing as the other; otherwise the fewest exchanges win.
    """
    from . import kernels

    solved, square, cost = solve_robust(rig, xy, score, sigma, settings)
    if not (square > kernels.USED).any():
        return solved
    touched = False
    for g in range(len(xy)):
        for group in limb_groups(skeleton):
            suspects = _suspects(rig, xy[g], score[g], sigma[g], solved.xyz[g], square[g], skeleton, group)
            if len(suspects) == 0:
                continue
            flips = _best_flips(
                rig, xy[g], score[g], sigma[g], skeleton, group, before[g] if before is not None else None, settings
            )
            if flips.any():
                touched = True
                for plane in (xy[g], score[g], sigma[g]):
                    _exchange(plane, flips, skeleton, group)
                part, square_part, _ = solve_robust(rig, xy[g : g + 1], score[g : g + 1], sigma[g : g + 1], settings)
                solved.xyz[g], square[g] = part.xyz[0], square_part[0]
    return solve_robust(rig, xy, score, sigma, settings)[0] if touched else solved


def _exchange(plane: Array, flips: Array, skeleton: Skeleton, group: Array) -> None:
    """Swap the sides of `group` in the flagged views of (C, K, ...), in place."""
    rows = np.flatnonzero(flips)[:, None]
    plane[rows, group] = plane[rows, skeleton.mirror[group]]


def _suspects(
    rig: Rig, xy: Array, score: Array, sigma: Array, xyz: Array, square: Array, skeleton: Skeleton, group: Array
) -> Array:
    """Views (indices) in which `group` misfits and, exchanged, would fit the points of the others in good part."""
    from . import kernels

    mirror = skeleton.mirror[group]
    seen = np.isfinite(square[:, group])
    bad = seen & (square[:, group] > kernels.USED)
    exchanged = np.empty((1, len(xy), len(group)))
    usable = np.where(score > 0, sigma, np.nan)
    kernels.squares_of(
        packed_rig(rig),
        np.ascontiguousarray(xy[None][:, :, mirror]),
        np.ascontiguousarray(usable[None][:, :, mirror]),
        np.ascontiguousarray(xyz[None][:, group]),
        exchanged,
    )
    fits = exchanged[0] < kernels.USED
    count = np.maximum(seen.sum(axis=1), 1)
    return np.flatnonzero((bad.sum(axis=1) >= np.maximum(2, _MISFIT * count)) & (fits.sum(axis=1) >= np.maximum(2, _FIT * count)))


def _best_flips(
    rig: Rig,
    xy: Array,
    score: Array,
    sigma: Array,
    skeleton: Skeleton,
    group: Array,
    before: Array | None,
    settings: FuseSettings,
) -> Array:
    """(C,) bool: which views to exchange, found one at a time, the most telling first: at most C rounds of C fusions."""
    count = len(xy)
    flips = np.zeros(count, bool)
    cost, _ = _costs(rig, xy, score, sigma, skeleton, group, flips[None], settings)
    best = cost[0]
    for _ in range(count):
        trials = flips ^ np.eye(count, dtype=bool)
        costs, _ = _costs(rig, xy, score, sigma, skeleton, group, trials, settings)
        winner = int(np.argmin(costs))
        if costs[winner] > best - _GAIN:
            break
        best, flips = costs[winner], trials[winner]
    if not flips.any():
        return flips
    # all views exchanged fit exactly as well: the two readings differ only in which side is called left
    both = np.stack([flips, ~flips])
    _, points = _costs(rig, xy, score, sigma, skeleton, group, both, settings)
    if before is not None:
        apart = np.linalg.norm(points - before[group], axis=-1)
        if np.isfinite(apart).any(axis=1).all():
            return both[int(np.argmin(np.nanmedian(apart, axis=1)))]
    return both[int(flips.sum() > count / 2)]


def _costs(
    rig: Rig,
    xy: Array,
    score: Array,
    sigma: Array,
    skeleton: Skeleton,
    group: Array,
    flips: Array,
    settings: FuseSettings,
) -> tuple[Array, Array]:
    """Robust loss (F,) of each way to exchange views (F, C), and the points (F, len(group), 3) it gives."""
    planes = []
    for plane in (xy, score, sigma):
        mixed = np.stack([plane[:, group]] * len(flips))
        swapped = plane[:, skeleton.mirror[group]]
        mixed[flips] = np.broadcast_to(swapped, mixed.shape)[flips]
        planes.append(mixed)
    solved, _, cost = solve_robust(rig, *planes, settings)
    return cost.sum(axis=1), solved.xyz
