"""People whom no one follows yet."""

from __future__ import annotations

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array

from .candidates import Candidates, agreement, joint_points, pair_midpoints
from .members import LEAST_POINTS, best_per_camera, settled
from .settings import AssociateSettings
from .traits import body_lengths_m, plausible_share


def newcomers(candidates: Candidates, free: Array, count: int, skeleton: Skeleton, settings: AssociateSettings) -> list[Array]:
    """Members of up to `count` people no one follows yet, the most convincing first."""
    people: list[Array] = []
    if count == 0:
        return people
    pairs, poses = _proposals(candidates, free, settings)
    if not len(pairs):
        return people
    support, share = agreement(candidates, poses, settings.tolerance_m)
    support = np.where(share >= settings.min_share, support, 0.0)
    while len(people) < count:
        best = _most_convincing(candidates, support * free, poses, settings)
        if best is None:
            break
        members = settled(candidates, best_per_camera(candidates, support[best] * free), free, settings)
        support[best] = 0.0
        if len(members) >= 2 and _is_a_body(candidates, members, skeleton, settings):
            people.append(members)
            free[members] = False
    return people


def _is_a_body(candidates: Candidates, members: Array, skeleton: Skeleton, settings: AssociateSettings) -> bool:
    """Whether a newcomer can be one: a third view that agrees shows it, two views must give the size of a human body.

    The rays of two different people in two views meet in anything.
    """
    if len(members) > 2:
        return True
    pose = joint_points(candidates, members, settings.tolerance_m)
    lengths = body_lengths_m(pose[None], skeleton)
    return not np.isfinite(lengths).any() or bool(plausible_share(lengths)[0] >= settings.plausible_share)


def _proposals(candidates: Candidates, free: Array, settings: AssociateSettings) -> tuple[Array, Array]:
    """Pairs (H, 2) of free detections of different cameras whose rays meet, and the poses (H, K, 3) they propose."""
    one, two = np.triu_indices(len(candidates), 1)
    pairs = np.stack([one, two], axis=1)[(candidates.camera[one] != candidates.camera[two]) & free[one] & free[two]]
    if not len(pairs):
        return pairs, np.zeros((0, candidates.score.shape[1], 3))
    poses, gap = pair_midpoints(candidates, pairs)
    seen = np.isfinite(gap).sum(axis=1)
    near = (gap < 2 * settings.tolerance_m).sum(axis=1)
    keep = (near >= LEAST_POINTS) & (near >= settings.min_share * seen)
    return pairs[keep], poses[keep]


def _most_convincing(candidates: Candidates, support: Array, poses: Array, settings: AssociateSettings) -> int | None:
    """The proposal with the most support over two or more cameras, or the nearest to `near_xy_m`; None when there is none."""
    by_camera = np.zeros((len(support), int(candidates.camera.max()) + 1))
    for c in range(by_camera.shape[1]):
        by_camera[:, c] = support[:, candidates.camera == c].max(axis=1, initial=0.0)
    total = np.where((by_camera > 0).sum(axis=1) >= 2, by_camera.sum(axis=1), 0.0)
    if not total.max() > 0:
        return None
    if settings.near_xy_m is None:
        return int(np.argmax(total))
    place = np.nanmedian(poses[..., :2], axis=1)
    apart = np.linalg.norm(place - np.asarray(settings.near_xy_m), axis=1)
    # among the proposals of one body the best supported one, so distance counts in steps of a body's width
    steps = np.where(total > 0, np.round(apart / 0.5), np.inf)
    return int(np.lexsort((-total, steps))[0])
