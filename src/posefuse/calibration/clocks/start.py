"""Clocks of cameras to about a frame, however far apart they started, from what they all watch.

With a known rig, simultaneous rays of two cameras meet in space: the wanted offset is the one at which points are nearest to
each other's epipolar lines. Without a rig, every point of a body moves approximately in a plane, of which two cameras see two
images; the wanted offset is the one at which homographies map one path best onto the other. A rigid target is seen on two
paths in space that are one rigid motion apart (`extrinsics.clocks`). Every pair of cameras shows by how much each offset is
better than the usual one; the offsets of all cameras are those on which the pairs agree best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.core import Camera, Rig
from posefuse.core.arrays import Array

from .paths import at_times
from .person_tracks import PersonTrack

STEP_S = 1 / 15
# two cameras must have seen so much together at an offset for it to count; without a rig, so much of a way
_LEAST_S, _LEAST_POINTS, _LEAST_MOMENTS = 1.5, 100, 40
# more time steps than this (to twice as many) do not improve the estimate
_MOMENTS = 80
_ROUNDS = 4
# offsets that are fewer steps apart are one
_SAME = 4
# of how many pairs the search begins: with one, 2 of 36 short walks with much noise have a wrong offset, and with all none
_STARTS = 24
Cost = Callable[[Array, Array], float]


@dataclass(frozen=True, eq=False)
class RoughClocks:
    """What the pairs of cameras agree on.

    Attributes:
        offset_s: (C,) how much later each camera's stamps are than the first one's; NaN where nothing links it.
        clearness: (C,) logarithm of how many times better than the usual offset it is, mean over a camera's pairs.
        other_s: (C,) the next best offset of each camera. rivalry: (C,) how good that is, as a share of the best.
    """

    offset_s: Array
    clearness: Array
    other_s: Array
    rivalry: Array


@dataclass(frozen=True, eq=False)
class _Pair:
    """How good each offset (L,) of camera b against a is, in steps from -most to most; 0 where the two do not determine it."""

    a: int
    b: int
    worth: Array


def rough_clocks(rig: Rig, tracks: Sequence[PersonTrack], most_s: float) -> RoughClocks:
    """Of cameras with the extrinsics of the rig."""
    grids = [EvenTrack.of(track) for track in tracks]
    norm = [camera.norm_from_px(grid.xy) for camera, grid in zip(rig, grids, strict=True)]

    def cost(a: int, b: int) -> Cost:
        b_from_a = rig.cameras[b].cam_from_world @ rig.cameras[a].cam_from_world.inverse()
        x, y, z = b_from_a.xyz
        lines = _with_one(norm[a]) @ (np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ b_from_a.matrix()).T
        lines = lines / np.linalg.norm(lines[..., :2], axis=-1, keepdims=True)
        points = _with_one(norm[b])

        def of(rows_a: Array, rows_b: Array) -> float:
            off = np.abs((lines[rows_a] * points[rows_b]).sum(axis=-1))
            off = off[np.isfinite(off)]
            return float(np.median(off)) if len(off) >= _LEAST_POINTS else float("nan")

        return of

    return agreed_clocks(grids, cost, most_s)


def rough_clocks_unplaced(cameras: Sequence[Camera], tracks: Sequence[PersonTrack], most_s: float) -> RoughClocks:
    """Of cameras at unknown places, from the way the person walks over the floor."""
    grids = [EvenTrack.of(track) for track in tracks]
    ways = [np.moveaxis(camera.norm_from_px(grid.xy), 0, 1) for camera, grid in zip(cameras, grids, strict=True)]
    return agreed_clocks(
        grids, lambda a, b: lambda rows_a, rows_b: _homography_misfit(ways[a][:, rows_a], ways[b][:, rows_b]), most_s
    )


@dataclass(frozen=True, eq=False)
class EvenTrack:
    """What a camera sees at even times: first number of steps, and points (F, P, D), NaN where unseen."""

    first: int
    xy: Array

    @property
    def seen(self) -> Array:
        """(F,) whether any point is."""
        return np.asarray(np.isfinite(self.xy).all(axis=-1).any(axis=-1))

    @classmethod
    def of(cls, track: PersonTrack) -> EvenTrack:
        """Of a person, read at these times."""
        t_s = track.t_s
        first, last = (round(float(t) / STEP_S) for t in t_s[[0, -1]])
        return cls(first, at_times(t_s, track.xy_img, np.arange(first, last + 1) * STEP_S))


def agreed_clocks(grids: Sequence[EvenTrack], cost: Callable[[int, int], Cost], most_s: float) -> RoughClocks:
    """The offsets on which pairs of cameras agree best.

    Args:
        grids: one per camera. cost: of cameras a and b, the misfit of steps of a with steps of b; NaN where these are too few.
        most_s: the farthest two cameras' clocks may be apart.
    """
    count, most = len(grids), round(most_s / STEP_S)
    pairs = [_pair(grids, a, b, cost(a, b), most) for a in range(count) for b in range(a + 1, count)]
    starts = sorted((pair for pair in pairs if pair.worth.max() > 0), key=lambda pair: -pair.worth.max())
    best, most_worth = np.full(count, np.nan), 0.0
    for pair in starts[:_STARTS]:
        steps = _placed(pair, pairs, count, most)
        worth = float(sum(_worth_at(one, steps[one.b] - steps[one.a], most) for one in pairs))
        if worth > most_worth:
            best, most_worth = steps, worth
    rivals = [_rival(c, best, pairs, most) for c in range(count)]
    clear, other, rivalry = (np.array(column) for column in zip(*rivals, strict=True))
    zero = best[np.isfinite(best)][:1]
    if not len(zero):
        return RoughClocks(best, best, best, best)
    return RoughClocks((best - zero) * STEP_S, clear, (other - zero) * STEP_S, rivalry)


def _pair(grids: Sequence[EvenTrack], a: int, b: int, cost: Cost, most: int) -> _Pair:
    left, share = np.full(2 * most + 1, np.nan), np.zeros(2 * most + 1)
    most_seen = max(int(one.seen.sum()) for one in grids)
    apart, seen_a, seen_b = grids[b].first - grids[a].first, grids[a].seen, grids[b].seen
    for i, late in enumerate(range(-most, most + 1)):
        begin, end = max(0, apart - late), min(len(grids[a].xy), apart - late + len(grids[b].xy))
        if (end - begin) * STEP_S < _LEAST_S:
            continue
        both = begin + np.flatnonzero(seen_a[begin:end] & seen_b[begin + late - apart : end + late - apart])
        if len(both) * STEP_S >= _LEAST_S:
            rows = both[:: max(1, len(both) // _MOMENTS)]
            left[i], share[i] = cost(rows, rows + late - apart), len(both) / most_seen
    usual = np.nanmedian(left) if np.isfinite(left).any() else np.nan
    with np.errstate(all="ignore"):
        # a short stretch is easily explained: it counts as little as it is long
        return _Pair(a, b, np.nan_to_num(share * np.log(usual / np.maximum(left, 1e-9))))


def _placed(first: _Pair, pairs: Sequence[_Pair], count: int, most: int) -> Array:
    """(C,) steps of all cameras when one pair's best are taken for granted: the clearest camera next; NaN where none is clear."""
    steps = np.full(count, np.nan)
    steps[first.a], steps[first.b] = 0.0, int(np.argmax(first.worth)) - most
    while True:
        open_ = [_best_of(int(c), steps, pairs, most) for c in np.flatnonzero(np.isnan(steps))]
        if not open_ or max(open_)[0] <= 0:
            return steps
        _, at, c = max(open_)
        steps[c] = at


def _best_of(c: int, steps: Array, pairs: Sequence[_Pair], most: int) -> tuple[float, int, int]:
    """Worth and place of the best offset of camera c, given those that have one."""
    at, worth = _worth_of(c, steps, pairs, most)
    best = int(np.argmax(worth))
    return float(worth[best]), int(at[best]), c


def _worth_of(c: int, steps: Array, pairs: Sequence[_Pair], most: int) -> tuple[Array, Array]:
    """Places that camera c may have, and how well the pairs it is in agree on each."""
    at = np.arange(int(np.nanmin(steps)) - most, int(np.nanmax(steps)) + most + 1)
    worth = np.zeros(len(at))
    for pair in pairs:
        if c in (pair.a, pair.b) and np.isfinite(other := steps[pair.a if c == pair.b else pair.b]):
            worth += _worth_at(pair, at - other if c == pair.b else other - at, most)
    return at, worth


def _worth_at(pair: _Pair, late: Array, most: int) -> Array:
    place = np.nan_to_num(np.asarray(late) + most, nan=-1.0).astype(int)
    inside = (place >= 0) & (place <= 2 * most)
    return np.where(inside, pair.worth[place.clip(0, 2 * most)], 0.0)


def _rival(c: int, steps: Array, pairs: Sequence[_Pair], most: int) -> tuple[float, float, float]:
    """How clear the place of camera c is, the next best one, and how good that is as a share of it."""
    if np.isnan(steps[c]):
        return float("nan"), float("nan"), float("nan")
    alone = steps.copy()
    alone[c] = np.nan
    at, worth = _worth_of(c, alone, pairs, most)
    others = np.where(np.abs(at - steps[c]) > _SAME, worth, -np.inf)
    other = int(np.argmax(others))
    best = worth[at == steps[c]][0]
    return float(best / np.isfinite(alone).sum()), float(at[other]), float(others[other] / best)


def _homography_misfit(p: Array, q: Array) -> float:
    """Distance usually left between q (P, n, 2) and ways p brought there by a homography each, in spreads of q.

    The half of the points that fits best is asked: hands and feet leave their planes.
    """
    both = np.asarray(np.isfinite(p).all(axis=-1) & np.isfinite(q).all(axis=-1))
    long = both.sum(axis=1) >= _LEAST_MOMENTS
    if not long.any():
        return float("nan")
    both = both[long]
    p, q = (_normalised(x[long], both) for x in (p, q))
    one = both[..., None].astype(float)
    along = np.concatenate([p, one], axis=-1)
    none = np.zeros_like(along)
    across = np.concatenate([along, none, -q[..., :1] * along], axis=-1)
    down = np.concatenate([none, along, -q[..., 1:] * along], axis=-1)
    rows = np.stack([across, down], axis=-2)
    weight = one[..., 0]
    for _ in range(_ROUNDS):
        weighted = (rows * weight[..., None, None]).reshape(len(rows), -1, 9)
        _, vectors = np.linalg.eigh(np.swapaxes(weighted, 1, 2) @ rows.reshape(len(rows), -1, 9))
        there = along @ np.swapaxes(vectors[..., 0].reshape(-1, 3, 3), 1, 2)
        depth = np.where(both, there[..., 2], 1.0)
        off = np.where(both, np.linalg.norm(there[..., :2] / depth[..., None] - q, axis=-1), np.inf)
        # the median of those that are known
        usual = np.sort(off, axis=1)[np.arange(len(off)), both.sum(axis=1) // 2]
        # as distances in the image count, not as the equations do
        weight = 1 / depth**2 / (1 + (off / usual[:, None]) ** 2)
    return float(np.sort(usual)[: max(1, len(usual) // 2)].mean())


def _normalised(x: Array, known: Array) -> Array:
    """Points (P, n, 2) about their mean, in units of their spread; 0 where not known."""
    x = np.where(known[..., None], x, np.nan)
    x = (x - np.nanmean(x, axis=1, keepdims=True)) / np.nanstd(x, axis=(1, 2), keepdims=True)
    return np.asarray(np.nan_to_num(x))


def _with_one(norm: Array) -> Array:
    return np.concatenate([norm, np.ones_like(norm[..., :1])], axis=-1)
