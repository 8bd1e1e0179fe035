"""Whether every camera stands still: one after the other gets a pose of its own in each stretch of the recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.report import Check
from posefuse.calibration.solving.point_solve import PointState, solve_points
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .bundle import PersonSolution

_STRETCHES = 8
# a move counts from this angle on, and from so many times what stretches without a move scatter by
_LEAST_RAD, _SIGMAS = np.deg2rad(0.35), 6.0
# two explanations whose cost differs by less than this share cannot be distinguished
_ALIKE = 0.02
_MOST_COMPARED = 300
# keypoints that are enough for this
STANDING_POINTS = 1200


@dataclass(frozen=True, eq=False)
class _Split:
    """A solve in which camera `of` has one pose before a time and another one afterwards.

    Attributes:
        solved: with the second pose as one more camera, the last one. cameras: of it. words: when it moved, and how far.
        ratio: the move over its limit. cost: of the keypoints, robust.
    """

    of: int
    solved: PersonSolution
    cameras: tuple[Camera, ...]
    words: str
    ratio: float
    cost: float


def check_standing(cameras: tuple[Camera, ...], solved: PersonSolution) -> Check:
    """No camera moves during the recording; all that do are named, each with the time."""
    now, everyone, worst = solved, cameras, 0.0
    words: list[str] = []
    left = list(range(len(cameras)))
    while len(left) > 1 or not words:
        splits = [_split(everyone, now, c) for c in left]
        worst = max(worst, max(split.ratio for split in splits))
        moved = sorted((split for split in splits if split.ratio > 1), key=lambda split: split.cost)
        if not moved:
            break
        alike = [one for one in moved[1:] if one.cost < moved[0].cost * (1 + _ALIKE)]
        words.append(" or ".join(split.words for split in (moved[0], *alike)))
        now, everyone = moved[0].solved, moved[0].cameras
        left = [c for c in left if c not in [one.of for one in (moved[0], *alike)]]
    detail = f"the largest move is {worst:.0%} of what would be noticed" if not words else "; ".join(words)
    return Check(
        "cameras stand still", not words, detail, "fasten it, and record again; or use the part before or after that time"
    )


def _split(cameras: tuple[Camera, ...], solved: PersonSolution, c: int) -> _Split:
    mine = np.flatnonzero(solved.rows.camera == c)
    since_s = solved.rows.since_s[mine]
    order = np.argsort(since_s, kind="stable")
    stretch = np.empty(len(mine), np.int64)
    stretch[order] = np.arange(len(mine)) * _STRETCHES // max(len(mine), 1)
    all_cameras, free = _with_poses(cameras, solved, c, mine, stretch)
    poses = free.solution.state.cam_from_world[np.r_[c, len(cameras) : len(all_cameras)]]
    seen = free.solution.state.xyz[solved.rows.point[mine[:: max(1, len(mine) // _MOST_COMPARED)]]]
    xy = np.stack([replace(cameras[c], cam_from_world=poses[i].se3()).project(seen) for i in range(len(poses))])
    focal_px = float(cameras[c].K[0, 0])
    ratio, first, last, step_px = _largest_step(xy, _LEAST_RAD * focal_px)
    edges = np.sort(since_s)[np.arange(1, _STRETCHES) * len(mine) // _STRETCHES] if len(mine) else np.zeros(_STRETCHES - 1)
    at_s = float(edges[first - 1 : last].mean())
    two_cameras, two = _with_poses(cameras, solved, c, mine, (since_s >= at_s).astype(np.int64))
    words = (f"{cameras[c].name} was moved at about {at_s - solved.rows.since_s.min():.0f} s, its view by"
             f" {np.rad2deg(step_px / focal_px):.1f} deg")  # fmt: skip
    return _Split(c, two, two_cameras, words, ratio, _cost(two, solved.solution.sigma_px))


def _with_poses(
    cameras: tuple[Camera, ...], solved: PersonSolution, c: int, mine: Array, part: Array
) -> tuple[tuple[Camera, ...], PersonSolution]:
    """The solve again with another pose of camera c for each part (n,) of its rows `mine` (n,) but the first."""
    more, camera, state = int(part.max(initial=0)), solved.rows.camera.copy(), solved.solution.state
    camera[mine] = np.where(part > 0, len(cameras) + part - 1, c)
    every = np.r_[: len(cameras), np.full(more, c)]
    all_cameras = (*cameras, *[cameras[c]] * more)
    rows = replace(solved.rows, camera=camera)
    start = PointState(state.cam_from_world[every], state.xyz, state.terms[every])
    return all_cameras, PersonSolution(solve_points(rows, all_cameras, start, solved.freedom), rows, solved.freedom)


def _largest_step(xy: Array, least_px: float) -> tuple[float, int, int, float]:
    """Of points (S, N, 2) seen by the pose of each stretch: the largest step over its limit, the stretches it lies between, px.

    A stretch in which the camera moves is no part of either side.
    """
    best, count = (0.0, 1, 1, 0.0), len(xy)
    good = np.isfinite(xy).all(axis=(0, 2))
    for first in range(1, count):
        for last in (first, first + 1):
            before, after = xy[:first, good], xy[last:, good]
            if not len(after) or not good.any():
                continue
            step_px = _size(after.mean(axis=0) - before.mean(axis=0))
            within = np.concatenate([before - before.mean(axis=0), after - after.mean(axis=0)])
            each_px = _size(within) * np.sqrt(len(within) / (len(within) - 2))
            sigma_px = each_px * np.sqrt(1 / len(before) + 1 / len(after))
            best = max(best, (float(step_px / max(least_px, _SIGMAS * sigma_px)), first, last, step_px))
    return best


def _size(off: Array) -> float:
    """Root mean square length of vectors (..., 2)."""
    return float(np.sqrt((off**2).sum(axis=-1).mean()))


def _cost(solved: PersonSolution, sigma_px: float) -> float:
    square = ((solved.solution.residual_px / solved.rows.relative_sigma[:, None] / sigma_px) ** 2).sum(axis=1)
    return float(np.log1p(np.nan_to_num(square, nan=1e6)).mean())
