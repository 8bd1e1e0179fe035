"""People whom no one follows yet."""

from __future__ import annotations

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array

from .candidates import LEAST_POINTS, Candidates, agreement, best_per_camera, member_points, pair_midpoints, refined_members
from .settings import AssociateSettings
from .traits import body_lengths_m, plausible_share


def newcomers(candidates: Candidates, free: Array, count: int, skeleton: Skeleton, settings: AssociateSettings) -> list[Array]:
    """Members of up to `count` people no one follows yet, the most convincing first."""
    people: list[Array] = []
    if count == 0:
        return people
    poses, views = _proposals(candidates, free, settings)
    if not len(poses):
        return people
    support, share = agreement(candidates, poses, settings.tolerance_m)
    support = np.where(share >= settings.min_share, support, 0.0) * free
    by_camera = _best_by_camera(candidates, support)
    while len(people) < count:
        best = _most_convincing(by_camera, poses, views, settings)
        if best is None:
            break
        members = refined_members(candidates, best_per_camera(candidates, support[best]), free, settings)
        support[best], by_camera[best] = 0.0, 0.0
        if len(members) >= views[best] and _is_a_body(candidates, members, skeleton, settings):
            people.append(members)
            free[members] = False
            # the proposals of this person alone change
            changed = support[:, members].any(axis=1)
            support[:, members] = 0.0
            by_camera[changed] = _best_by_camera(candidates, support[changed])
    return people


def _best_by_camera(candidates: Candidates, support: Array) -> Array:
    """(H, C) the most support that proposals (H, R) have in each camera."""
    by_camera = np.zeros((len(support), int(candidates.camera.max()) + 1))
    for c in range(by_camera.shape[1]):
        by_camera[:, c] = support[:, candidates.camera == c].max(axis=1, initial=0.0)
    return by_camera


def _is_a_body(candidates: Candidates, members: Array, skeleton: Skeleton, settings: AssociateSettings) -> bool:
    """Whether a newcomer can be one: a third view that agrees shows it, fewer must give the size of a human body.

    The rays of two different people in two views meet in anything, and depth may be that of anything.
    """
    if len(members) > 2:
        return True
    pose = member_points(candidates, members, settings.tolerance_m)
    lengths = body_lengths_m(pose[None], skeleton)
    if len(members) == 1 and not np.isfinite(lengths).any():
        return False
    return not np.isfinite(lengths).any() or bool(plausible_share(lengths)[0] >= settings.plausible_share)


def _proposals(candidates: Candidates, free: Array, settings: AssociateSettings) -> tuple[Array, Array]:
    """Poses (H, K, 3) that free detections propose, and how many views (H,) must agree with each.

    Two of different cameras propose where their rays meet; a single one with depth proposes itself.
    """
    poses = _of_pairs(candidates, free, settings)
    views = np.full(len(poses), 2)
    if candidates.deep_world is None:
        return poses, views
    alone = candidates.deep_world[free & (np.isfinite(candidates.deep_world[..., 0]).sum(axis=1) >= LEAST_POINTS)]
    return np.concatenate([poses, alone]), np.concatenate([views, np.ones(len(alone), np.int64)])


def _of_pairs(candidates: Candidates, free: Array, settings: AssociateSettings) -> Array:
    """(H, K, 3) where the rays of free detections of two different cameras meet."""
    one, two = np.triu_indices(len(candidates), 1)
    pairs = np.stack([one, two], axis=1)[(candidates.camera[one] != candidates.camera[two]) & free[one] & free[two]]
    if not len(pairs):
        return np.zeros((0, candidates.score.shape[1], 3))
    poses, gap = pair_midpoints(candidates, pairs)
    seen = np.isfinite(gap).sum(axis=1)
    near = (gap < 2 * settings.tolerance_m).sum(axis=1)
    keep = (near >= LEAST_POINTS) & (near >= settings.min_share * seen)
    return np.asarray(poses[keep])


def _most_convincing(by_camera: Array, poses: Array, views: Array, settings: AssociateSettings) -> int | None:
    """The proposal with the most support (H, C) over enough cameras, or the nearest to `near_xy_m`; None when there is none."""
    total = np.where((by_camera > 0).sum(axis=1) >= views, by_camera.sum(axis=1), 0.0)
    if not total.max() > 0:
        return None
    if settings.near_xy_m is None:
        return int(np.argmax(total))
    place = np.nanmedian(poses[..., :2], axis=1)
    apart = np.linalg.norm(place - np.asarray(settings.near_xy_m), axis=1)
    # among the proposals of one body the best supported one, so distance counts in steps of a body's width
    steps = np.where(total > 0, np.round(apart / 0.5), np.inf)
    return int(np.lexsort((-total, steps))[0])
