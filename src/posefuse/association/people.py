"""Association: detections of every camera to the same people in every camera."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from posefuse.core import Detections2D, Pose3D, Rig, ShapeError, Skeleton, Views
from posefuse.core.arrays import Array, median_apart
from posefuse.core.duplicates import duplicates
from posefuse.core.errors import choices
from posefuse.core.values import UNSEEN

from .candidates import (
    LEAST_POINTS,
    Assignment,
    Candidates,
    agreement,
    best_per_camera,
    candidates_from_detections,
    joint_points,
    pair_midpoints,
    refined_members,
)
from .settings import AssociateSettings
from .traits import body_lengths_m, plausible_share


def associate(detections: Sequence[Detections2D], rig: Rig, settings: AssociateSettings, previous: Pose3D | None = None) -> Views:
    """The people in every camera: `assign` at the time of the newest detection, and the resulting views."""
    t_ns = max(d.t_ns for d in detections)
    return assign(detections, rig, settings, t_ns, previous).views(detections, t_ns)


def assign(
    detections: Sequence[Detections2D],
    rig: Rig,
    settings: AssociateSettings,
    t_ns: int,
    previous: Pose3D | None = None,
    *,
    seen_ns: Array | None = None,
    next_id: int | None = None,
) -> Assignment:
    """Pick, for each person, at most one detection per camera.

    A body that a view reports several times counts once. The people followed come first: their previous pose is held against
    every detection. Then newcomers: every pair of detections of two cameras, and every detection with depth, proposes a pose;
    the one most views agree on wins, its detections are taken, and so on (pairs are O(detections^2); nothing is exponential).
    Each choice is settled by fusing its members and asking again who agrees.

    Args:
        detections: one per camera of the rig, in its order, of one skeleton.
        rig: the cameras.
        settings: see `AssociateSettings`.
        t_ns: the time step that the detections belong to, session clock.
        previous: the newest pose (at best predicted to this time step) of the people. A person in it is followed; the place of
            one out of sight is kept free for `lost_after_s`, and only a person who can be that person takes it.
        seen_ns: (N,) when each person of `previous` was last measured; None: at its time.
        next_id: newcomers get this id, the next and so on; None: the lowest free ones.

    Returns:
        Assignment: a row per person found, ordered by id. A followed person seen by a single camera has a row; a newcomer
        needs two cameras, or one with depth.

    Raises:
        ShapeError: detections that do not match the rig's cameras, or each other's skeleton.
    """
    _check(detections, rig)
    candidates = candidates_from_detections(detections, rig)
    free = ~np.concatenate([duplicates(one, settings.duplicate_share) for one in detections])
    followed = _followed(previous, seen_ns, t_ns) if previous is not None and previous.skeleton == detections[0].skeleton else []
    found = _follow(candidates, free, followed, settings)
    lost = [one for one in followed if one.person_id not in found and one.age_s <= settings.lost_after_s]
    room = settings.max_people - len(found)
    if room > 0:
        taken = {one.person_id for one in lost} | set(found)
        ids = itertools.count(next_id) if next_id is not None else (i for i in itertools.count() if i not in taken)
        strangers = room - len(lost)
        for members in newcomers(candidates, free, room, detections[0].skeleton, settings):
            again = _found_again(candidates, members, lost, settings)
            if again is not None:
                lost.remove(again)
                found[again.person_id] = members
            elif strangers > 0:
                strangers -= 1
                found[next(ids)] = members
    return _assignment(len(rig), candidates, found)


@dataclass(frozen=True, eq=False)
class _Known:
    """A person followed until now: pose (K, 3) expected now, and for how long nothing has measured it."""

    person_id: int
    xyz_world: Array
    age_s: float


def _followed(previous: Pose3D, seen_ns: Array | None, t_ns: int) -> list[_Known]:
    times_ns = np.full(len(previous.person_id), previous.t_ns) if seen_ns is None else seen_ns
    return [
        _Known(int(person), xyz, abs(t_ns - int(then)) * 1e-9)
        for person, xyz, then in zip(previous.person_id, previous.xyz_world, times_ns, strict=True)
        if np.isfinite(xyz[:, 0]).any()
    ]


def _found_again(candidates: Candidates, members: Array, lost: list[_Known], settings: AssociateSettings) -> _Known | None:
    """The nearest of the people out of sight who can have moved here; None if the distance is too large for all."""
    pose = joint_points(candidates, members, settings.tolerance_m)
    apart_m = {one.person_id: median_apart(pose, one.xyz_world) for one in lost}
    can_be = [one for one in lost if apart_m[one.person_id] <= max(_reach_m(one.age_s, settings), 4 * settings.tolerance_m)]
    return min(can_be, key=lambda one: apart_m[one.person_id], default=None)


def _reach_m(age_s: float, settings: AssociateSettings) -> float:
    return settings.tolerance_m + settings.speed_max_m_s * age_s


def _check(detections: Sequence[Detections2D], rig: Rig) -> None:
    names = tuple(d.camera for d in detections)
    if names != rig.names:
        raise ShapeError(f"associate: expected detections of cameras {choices(rig.names)}, in this order, got {choices(names)}")
    if any(d.skeleton != detections[0].skeleton for d in detections):
        raise ShapeError(
            f"associate: expected one skeleton in all cameras, got {choices(sorted({d.skeleton.name for d in detections}))}"
        )


def _follow(candidates: Candidates, free: Array, followed: list[_Known], settings: AssociateSettings) -> dict[int, Array]:
    """The detections of each followed person; marks them taken."""
    found: dict[int, Array] = {}
    reach = np.array([min(_reach_m(one.age_s, settings), 4 * settings.tolerance_m) for one in followed])
    expected = np.array([one.xyz_world for one in followed]).reshape(-1, len(candidates.mirror), 3)
    _, share = agreement(candidates, expected, reach)
    # how closely it fits decides between people; within reach it only can be one of them (by the same reach, IDF1 of rendered
    # people who cross and hug falls from 0.902 to 0.880)
    support, _ = agreement(candidates, expected, settings.tolerance_m)
    support = np.where(share >= settings.min_share, support, 0.0)
    mine = _one_each(candidates.camera, np.where(free, support, 0.0))
    for row, person in enumerate(followed):
        members = best_per_camera(candidates, np.where(mine[row], support[row], 0.0))
        members, pose = refined_members(candidates, members, mine[row], settings)
        # a single view without depth has no distance; a bystander in front of the others in one view is too far away
        no_distance = len(members) == 1 and not np.isfinite(pose).any()
        if no_distance or median_apart(pose, person.xyz_world) <= reach[row]:
            found[person.person_id] = members
            free[members] = False
    return found


def _one_each(camera: Array, support: Array) -> Array:
    """(N, D) bool: of each camera's detections, each person has one at most, so that the support (N, D) of all is greatest.

    With each camera's best for everybody, IDF1 of rendered people who cross and hug falls from 0.902 to 0.867.
    """
    mine = np.zeros(support.shape, np.bool_)
    for c in np.unique(camera):
        places = np.flatnonzero(camera == c)
        rows, columns = linear_sum_assignment(-support[:, places])
        mine[rows, places[columns]] = support[rows, places[columns]] > 0
    return mine


def _assignment(cameras: int, candidates: Candidates, found: dict[int, Array]) -> Assignment:
    ids = sorted(found)
    place = np.full((len(ids), cameras), UNSEEN)
    for row, person in enumerate(ids):
        place[row, candidates.camera[found[person]]] = candidates.place[found[person]]
    return Assignment(person_id=np.array(ids, np.int64), place=place)


def newcomers(candidates: Candidates, free: Array, count: int, skeleton: Skeleton, settings: AssociateSettings) -> list[Array]:
    """Members of up to `count` people no one follows yet, the most convincing first."""
    people: list[Array] = []
    poses, views = _proposals(candidates, free, settings)
    support = agreement(candidates, poses, settings.tolerance_m)[0] * free
    total = _support_of_all(candidates, support)
    while len(people) < count and total.max(initial=0.0) > 0:
        best = _most_convincing(total, poses, settings)
        members, pose = refined_members(candidates, best_per_camera(candidates, support[best]), free, settings)
        support[best], total[best] = 0.0, 0.0
        if len(members) >= views[best] and _is_a_body(members, pose, skeleton, settings):
            people.append(members)
            free[members] = False
            # the proposals of this person alone change
            changed = support[:, members].any(axis=1)
            support[:, members] = 0.0
            total[changed] = _support_of_all(candidates, support[changed])
    return people


def _support_of_all(candidates: Candidates, support: Array) -> Array:
    """(H,) the most support that proposals (H, D) have in each camera, together."""
    first = np.unique(candidates.camera, return_index=True)[1]
    return np.asarray(np.maximum.reduceat(support, first, axis=1).sum(axis=1))


def _is_a_body(members: Array, pose: Array, skeleton: Skeleton, settings: AssociateSettings) -> bool:
    """Whether a newcomer can be one: a third view that agrees shows it, fewer must give the size of a human body.

    The rays of two different people in two views meet in anything, and depth may be that of anything.
    """
    lengths = body_lengths_m(pose[None], skeleton)
    if len(members) > 2 or not np.isfinite(lengths).any():
        return len(members) > 1
    return bool(plausible_share(lengths)[0] >= settings.plausible_share)


def _proposals(candidates: Candidates, free: Array, settings: AssociateSettings) -> tuple[Array, Array]:
    """Poses (H, K, 3) that free detections propose, and how many views (H,) must agree with each.

    Two of different cameras propose where their rays meet; a single one with depth proposes itself.
    """
    one, two = np.triu_indices(len(candidates), 1)
    pairs = np.stack([one, two], axis=1)[(candidates.camera[one] != candidates.camera[two]) & free[one] & free[two]]
    poses, gap = pair_midpoints(candidates, pairs)
    near = (gap < 2 * settings.tolerance_m).sum(axis=1)
    poses = poses[(near >= LEAST_POINTS) & (near >= settings.min_share * np.isfinite(gap).sum(axis=1))]
    views = np.full(len(poses), 2)
    if candidates.deep_world is None:
        return poses, views
    alone = candidates.deep_world[free & (np.isfinite(candidates.deep_world[..., 0]).sum(axis=1) >= LEAST_POINTS)]
    return np.concatenate([poses, alone]), np.concatenate([views, np.ones(len(alone), np.int64)])


def _most_convincing(total: Array, poses: Array, settings: AssociateSettings) -> int:
    """The proposal with the most support (H,), or the one nearest to `near_xy_m` of those that have any."""
    if settings.near_xy_m is None:
        return int(np.argmax(total))
    place = np.nanmedian(poses[..., :2], axis=1)
    apart = np.linalg.norm(place - np.asarray(settings.near_xy_m), axis=1)
    # among the proposals of one body the best supported one, so distance counts in steps of a body's width
    steps = np.where(total > 0, np.round(apart / 0.5), np.inf)
    return int(np.lexsort((-total, steps))[0])
