"""One rigid transform out of many ambiguous estimates, and graphs of such transforms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posefuse.calibration.solving.rotations import Poses
from posefuse.core.arrays import Array

_MOST_SEEDS = 48
_CUT = 3.0


@dataclass(frozen=True, eq=False)
class Edge:
    """How two nodes lie to each other: a_from_b, the number of estimates that agree and their share."""

    a_from_b: Poses
    agreeing: int
    share: float
    score: float


def vote(candidates: Poses, angle_rad: float, distance_m: Array) -> Edge:
    """The transform most estimates agree with.

    Args:
        candidates: (n, h) estimates, h alternatives each, of which at most one is right; NaN where there is none.
        angle_rad: scale of what counts as agreeing.
        distance_m: (n,) likewise, for each estimate.
    """
    seeds = seeds_of(candidates, _MOST_SEEDS)
    cosine = (np.einsum("sij,nhij->snh", seeds.R, candidates.R) - 1) / 2
    angle = np.arccos(np.clip(cosine, -1, 1)) / angle_rad
    distance = np.linalg.norm(seeds.t[:, None, None] - candidates.t, axis=-1) / distance_m[:, None]
    return best_seed(seeds, np.nan_to_num(angle**2 + distance**2, nan=np.inf).min(axis=2))


def seeds_of(candidates: Poses, most: int) -> Poses:
    """The alternatives of at most so many of the (n, h) candidates, spread over all of them, as one stack."""
    n = len(candidates)
    picked = np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64))
    seeds = Poses(candidates.R[picked].reshape(-1, 3, 3), candidates.t[picked].reshape(-1, 3))
    return seeds[np.isfinite(seeds.t).all(axis=1)]


def best_seed(seeds: Poses, square: Array) -> Edge:
    """The seed that fits most estimates. square: (seeds, n) squared distance of each estimate from each seed, in its scale."""
    gain = np.maximum(0, 1 - square / _CUT**2)
    best = int(np.argmax(gain.sum(axis=1)))
    agreeing = int((gain[best] > 0).sum())
    return Edge(seeds[best], agreeing, agreeing / square.shape[1], float(gain[best].sum()))


def tree(count: int, edges: Mapping[tuple[int, int], Edge], root: int | None = None) -> tuple[int, dict[int, Poses]]:
    """Follow the strongest edges (Prim 1957): the root and root_from_node of every node that can be reached.

    Without a root, the node with most agreement over its edges is taken.
    """
    strength = np.zeros(count)
    for (a, b), edge in edges.items():
        strength[a] += edge.score
        strength[b] += edge.score
    root = int(np.argmax(strength)) if root is None else root
    reached = {root: Poses(np.eye(3), np.zeros(3))}
    while True:
        front = [(e.score, -a, -b) for (a, b), e in edges.items() if (a in reached) != (b in reached)]
        if not front:
            return root, reached
        _, a, b = max(front)
        edge = edges[(-a, -b)]
        if -a in reached:
            reached[-b] = reached[-a] @ edge.a_from_b
        else:
            reached[-a] = reached[-b] @ edge.a_from_b.inverse()
