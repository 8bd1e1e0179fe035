"""Left and right exchanged in a view: found by what fits the other views, and put right.

Estimators confuse sides of a limb, or of the whole body, in single views. Such a view is wrong in a known way, so it is
exchanged back rather than thrown away.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from posefuse.core import Rig, Skeleton
from posefuse.core.arrays import Array

from .packed import packed_rig
from .settings import FuseSettings
from .triangulate import RobustSolution, Triangulated, settled_points, solve_robust

# an exchange must win by this much robust loss: two clear outliers' worth, so noise never exchanges
_GAIN = 24.0
# and no limb may lose this much
_OBJECTION = 6.0
# share of a limb's keypoints in a view that must misfit before a swap is tested, and that must fit after it
_MISFIT, _FIT = 0.3, 0.3
# and pairs of keypoints must vote for it: least number, least share, least number for each vote against
_WON_LEAST, _WON_SHARE, _WON_PER_LOST = 2, 0.4, 2
# two views are met by a point nearly always, three only where they agree; four would leave rigs of three cameras uncorrected
_REDUNDANT = 3


@lru_cache(maxsize=16)
def limb_groups(skeleton: Skeleton) -> tuple[Array, ...]:
    """Keypoint indices of what may be exchanged together: the whole body, arms, legs, head; sided keypoints only."""
    sided = np.flatnonzero(skeleton.mirror != np.arange(len(skeleton)))
    limbs = [np.intersect1d(sides, sided) for sides in skeleton.limbs]
    head = np.setdiff1d(sided, np.concatenate([np.zeros(0, np.intp), *limbs]))
    return tuple(group for group in (sided, *limbs, head) if len(group))


@dataclass(frozen=True, eq=False)
class _Person:
    """What all cameras saw of one person at one time step: xy (C, K, 2), score and sigma (C, K), depth (C, K, 2) or None."""

    rig: Rig
    skeleton: Skeleton
    settings: FuseSettings
    xy: Array
    score: Array
    sigma: Array
    depth: Array | None

    @property
    def planes(self) -> list[Array]:
        """All that belongs to a side, and changes it."""
        return [self.xy, self.score, self.sigma, *([] if self.depth is None else [self.depth])]

    def exchanged(self, flips: Array, group: Array) -> list[Array]:
        """The keypoints of `group` under each of F ways (F, C) to exchange views: (F, C, len(group), ...) of each plane."""
        mirror = self.skeleton.mirror[group]
        planes = []
        for plane in self.planes:
            mixed = np.stack([plane[:, group]] * len(flips))
            mixed[flips] = np.broadcast_to(plane[:, mirror], mixed.shape)[flips]
            # picking columns turns the memory order, which the kernels would be compiled again for
            planes.append(np.ascontiguousarray(mixed))
        return planes

    def fit(self, flips: Array, group: Array) -> RobustSolution:
        """Robust fusion (F, len(group)) under each way to exchange views (F, C)."""
        xy, score, sigma, *depth = self.exchanged(flips, group)
        return solve_robust(self.rig, xy, score, sigma, self.settings, depth=depth[0] if depth else None)

    def fit_now(self) -> RobustSolution:
        """Robust fusion (1, K) as the views are."""
        depth = None if self.depth is None else self.depth[None]
        return solve_robust(self.rig, self.xy[None], self.score[None], self.sigma[None], self.settings, depth=depth)

    def exchange(self, flips: Array, group: Array) -> None:
        """Swap the sides of `group` in the flagged views, in place."""
        rows = np.flatnonzero(flips)[:, None]
        for plane in self.planes:
            plane[rows, group] = plane[rows, self.skeleton.mirror[group]]


def solve_with_swaps_corrected(
    rig: Rig,
    xy: Array,
    score: Array,
    sigma: Array,
    skeleton: Skeleton,
    before: Array | None,
    settings: FuseSettings,
    depth: Array | None = None,
) -> Triangulated:
    """Robust fusion of groups (G, C, K, ...) with views put right side out, which are exchanged in place.

    `before` (G, K, 3) decides a tie between views; otherwise the smallest number of swaps wins.
    """
    from .kernels import robust

    solved = solve_robust(rig, xy, score, sigma, settings, depth=depth)
    if (solved.square > robust.USED).any():
        touched = False
        for g in range(len(xy)):
            person = _Person(
                rig, skeleton, settings, xy=xy[g], score=score[g], sigma=sigma[g], depth=None if depth is None else depth[g]
            )
            past = None if before is None else before[g]
            touched |= _correct_swaps(person, solved.points.xyz[g], solved.square[g], past)
        if touched:
            solved = solve_robust(rig, xy, score, sigma, settings, depth=depth)
    return settled_points(solved, rig, xy, score=score, sigma=sigma, settings=settings, depth=depth)


def _correct_swaps(person: _Person, xyz: Array, square: Array, before: Array | None) -> bool:
    """Swap left and right of each group of limbs where the view has them swapped; returns whether any was."""
    touched = False
    exchanged = _exchanged_squares(person, xyz)
    for group in limb_groups(person.skeleton):
        if not _suspicious(square[:, group], exchanged[:, group]):
            continue
        flips = _best_flips(person, group, before)
        if flips.any():
            touched = True
            person.exchange(flips, group)
            again = person.fit_now()
            square = again.square[0]
            exchanged = _exchanged_squares(person, again.points.xyz[0])
    return touched


def _exchanged_squares(person: _Person, xyz: Array) -> Array:
    """(C, K) squared residuals of points (K, 3) in views whose sides are exchanged; NaN where either is missing."""
    from .kernels import robust

    mirror = person.skeleton.mirror
    xy, score, sigma = (np.ascontiguousarray(plane[None, :, mirror]) for plane in (person.xy, person.score, person.sigma))
    square = np.empty(sigma.shape)
    there = np.ascontiguousarray(xyz[None])
    robust.squares_of(packed_rig(person.rig), xy, np.where(score > 0, sigma, np.nan), there, square)
    return np.asarray(square[0])


def _suspicious(square: Array, exchanged: Array) -> bool:
    """Whether in some view a limb misfits and, exchanged, would fit the points of the others in good part.

    square, exchanged: (C, k) squared residuals of its keypoints as they are and exchanged.
    """
    from .kernels import robust

    seen = np.isfinite(square)
    misfits = (seen & (square > robust.USED)).sum(axis=1)
    fits = (exchanged < robust.USED).sum(axis=1)
    count = seen.sum(axis=1)
    return bool(((misfits >= np.maximum(2, _MISFIT * count)) & (fits >= np.maximum(2, _FIT * count))).any())


def _best_flips(person: _Person, group: Array, before: Array | None) -> Array:
    """(C,) bool: which views to exchange, found one at a time, the most telling first: at most C rounds of C fusions."""
    count = len(person.rig)
    flips = np.zeros(count, bool)
    limbs = [part for limb in limb_groups(person.skeleton)[1:] if (part := np.isin(group, limb)).any()]
    now = person.fit(flips[None], group)
    best, fits = now.cost[0], _pairs_fit(person, group, now.square)[0]
    for _ in range(count):
        trials = flips ^ np.eye(count, dtype=bool)
        solved = person.fit(trials, group)
        all_fits = _pairs_fit(person, group, solved.square)
        votes = _votes(fits, all_fits[np.arange(count), np.arange(count)])
        # a body is exchanged as a whole only if no limb objects
        worse = np.stack([solved.cost[:, limb].sum(axis=1) - best[limb].sum() for limb in limbs]).max(axis=0)
        total = solved.cost.sum(axis=1)
        carried = (votes > 0) & (worse < _OBJECTION) & (total < best.sum() - _GAIN)
        if not carried.any():
            break
        winner = int(np.lexsort((total, -np.where(carried, votes, 0)))[0])
        best, flips, fits = solved.cost[winner], trials[winner], all_fits[winner]
    if not flips.any():
        return flips
    # all views exchanged fit exactly as well: the two readings differ only in which side is called left
    both = np.stack([flips, ~flips])
    if before is not None:
        apart = np.linalg.norm(person.fit(both, group).points.xyz - before[group], axis=-1)
        if np.isfinite(apart).any(axis=1).all():
            return np.asarray(both[int(np.argmin(np.nanmedian(apart, axis=1)))])
    return np.asarray(both[int(flips.sum() > count / 2)])


def _pairs_fit(person: _Person, group: Array, square: Array) -> Array:
    """(F, C, P) whether both keypoints of each of the P pairs of `group` fit a view, from squares (F, C, len(group))."""
    from .kernels import robust

    place = {int(k): i for i, k in enumerate(group)}
    mirror = person.skeleton.mirror
    one, other = np.array([(i, place[int(mirror[k])]) for i, k in enumerate(group) if mirror[k] > k]).T
    fits = square < robust.USED
    # two rays nearly meet by chance as well
    fits &= fits.sum(axis=1, keepdims=True) >= _REDUNDANT
    return np.asarray(fits[..., one] & fits[..., other])


def _votes(before: Array, after: Array) -> Array:
    """(C,) pairs that fit a view once it is exchanged less those that no longer do, from (C, P); 0: too few to believe it.

    An exchange puts nearly all pairs right. Outliers change the loss of single pairs as much, when three land on one keypoint.
    """
    won, lost = (after & ~before).sum(axis=1), (before & ~after).sum(axis=1)
    enough = (won >= np.maximum(_WON_LEAST, _WON_SHARE * before.shape[1])) & (won >= _WON_PER_LOST * lost)
    return np.where(enough, won - lost, 0)
