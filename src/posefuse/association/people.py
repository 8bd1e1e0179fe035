"""Who is who: detections of every camera to the same people in every camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posefuse.core import Detections2D, Pose3D, Rig, ShapeError, Views
from posefuse.core.arrays import Array
from posefuse.core.errors import choices

from .assignment import UNSEEN, Assignment
from .candidates import Candidates, agreement, candidates_from_detections, joint_points, meeting_points
from .settings import AssociateSettings

# a newcomer needs this many keypoints in 3D: fewer say nothing about whose they are
_MIN_POINTS = 3
_ALONE_SHARE = 0.7


def associate(detections: Sequence[Detections2D], rig: Rig, settings: AssociateSettings, previous: Pose3D | None = None) -> Views:
    """The people in every camera: `assign` at the time of the newest detection, and the views that come of it."""
    t_ns = max(d.t_ns for d in detections)
    return assign(detections, rig, settings, t_ns, previous).views(detections, t_ns)


def assign(
    detections: Sequence[Detections2D], rig: Rig, settings: AssociateSettings, t_ns: int, previous: Pose3D | None = None
) -> Assignment:
    """Pick, for each person, at most one detection per camera.

    Those already followed come first: their previous pose is held against every detection. Then newcomers: every pair
    of detections of two cameras proposes a pose, the one most views agree on wins, its detections are taken, and so on
    (pairs are O(detections^2); nothing is exponential). Each choice is settled by fusing its members and asking again
    who agrees.

    Args:
        detections: one per camera of the rig, in its order, of one skeleton.
        rig: the cameras.
        settings: see `AssociateSettings`.
        t_ns: the time step that the detections belong to, session clock.
        previous: the newest pose (at best predicted to this instant) in which the people were found. A person in it is
            followed; the id of one out of sight is kept free for `lost_after_s`.

    Returns:
        Assignment: a row per person found, ordered by id. A followed person seen by a single camera has a row; a newcomer
        needs two cameras.

    Raises:
        ShapeError: detections that do not match the rig's cameras, or each other's skeleton.
    """
    _check(detections, rig)
    candidates = candidates_from_detections(detections, rig)
    free = np.ones(len(candidates), bool)
    found: dict[int, Array] = {}
    kept: set[int] = set()
    if previous is not None and previous.skeleton == detections[0].skeleton:
        age_s = abs(t_ns - previous.t_ns) * 1e-9
        present = np.isfinite(previous.xyz_world[..., 0]).any(axis=-1)
        followed = [(int(i), xyz) for i, xyz in zip(previous.person_id[present], previous.xyz_world[present], strict=True)]
        if age_s <= settings.lost_after_s:
            kept = {person for person, _ in followed}
        _follow(candidates, free, followed, age_s, settings, found)
    open_ids = [i for i in range(settings.max_people) if i not in kept and i not in found]
    for person, members in zip(open_ids, _newcomers(candidates, free, len(open_ids), settings), strict=False):
        found[person] = members
    return _assignment(len(rig), candidates, found)


def _check(detections: Sequence[Detections2D], rig: Rig) -> None:
    names = tuple(d.camera for d in detections)
    if names != rig.names:
        raise ShapeError(f"associate: expected detections of cameras {choices(rig.names)}, in this order, got {choices(names)}")
    if any(d.skeleton != detections[0].skeleton for d in detections):
        raise ShapeError(
            f"associate: expected one skeleton in all cameras, got {choices(sorted({d.skeleton.name for d in detections}))}"
        )


def _follow(
    candidates: Candidates,
    free: Array,
    followed: list[tuple[int, Array]],
    age_s: float,
    settings: AssociateSettings,
    found: dict[int, Array],
) -> None:
    """Give each followed person their detections, the best supported person first; marks them taken."""
    if not followed or not len(candidates):
        return
    reach = min(settings.tolerance_m + settings.speed_max_m_s * age_s, 4 * settings.tolerance_m)
    support, share = agreement(candidates, np.stack([xyz for _, xyz in followed]), reach)
    support = np.where(share >= settings.min_share, support, 0.0)
    # a detection goes to whom it supports most
    mine = support >= support.max(axis=0, keepdims=True)
    for row in np.argsort(-support.sum(axis=1), kind="stable"):
        members = _best_per_camera(candidates, np.where(mine[row] & free, support[row], 0.0))
        members = _settled(candidates, members, free, settings)
        if len(members) and _is_near(candidates, members, followed[row][1], reach, settings):
            found[followed[row][0]] = members
            free[members] = False


def _is_near(candidates: Candidates, members: Array, before: Array, reach_m: float, settings: AssociateSettings) -> bool:
    """Whether the members' pose is where the person can be: a bystander in front of them in one view is not."""
    if len(members) < 2:
        # one view does not tell how far away: it must fit the previous pose closely, size included
        _, share = agreement(candidates, before[None], settings.tolerance_m)
        return bool(share[0, members[0]] >= _ALONE_SHARE)
    apart = np.linalg.norm(joint_points(candidates, members, settings.tolerance_m) - before, axis=-1)
    return bool(np.isfinite(apart).any() and np.nanmedian(apart) <= reach_m)


def _newcomers(candidates: Candidates, free: Array, count: int, settings: AssociateSettings) -> list[Array]:
    """Members of up to `count` people nobody follows yet, the most convincing first."""
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
        members = _settled(candidates, _best_per_camera(candidates, support[best] * free), free, settings)
        support[best] = 0.0
        if len(members) >= 2:
            people.append(members)
            free[members] = False
    return people


def _proposals(candidates: Candidates, free: Array, settings: AssociateSettings) -> tuple[Array, Array]:
    """Pairs (H, 2) of free detections of different cameras whose rays meet, and the poses (H, K, 3) they propose."""
    one, two = np.triu_indices(len(candidates), 1)
    pairs = np.stack([one, two], axis=1)[(candidates.camera[one] != candidates.camera[two]) & free[one] & free[two]]
    if not len(pairs):
        return pairs, np.zeros((0, candidates.score.shape[1], 3))
    poses, gap = meeting_points(candidates, pairs)
    seen = np.isfinite(gap).sum(axis=1)
    near = (gap < 2 * settings.tolerance_m).sum(axis=1)
    keep = (near >= _MIN_POINTS) & (near >= settings.min_share * seen)
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


def _best_per_camera(candidates: Candidates, support: Array) -> Array:
    """Indices of the best supported detection of each camera; cameras without support have none."""
    order = np.argsort(-support, kind="stable")
    order = order[support[order] > 0]
    _, first = np.unique(candidates.camera[order], return_index=True)
    return np.sort(order[first])


def _settled(candidates: Candidates, members: Array, free: Array, settings: AssociateSettings) -> Array:
    """Fuse the members and ask every free detection again; once more with the answer. A single member stays as it is."""
    for _ in range(2):
        if len(members) < 2:
            return members
        pose = joint_points(candidates, members, settings.tolerance_m)
        if np.isfinite(pose[:, 0]).sum() < _MIN_POINTS:
            return members[:0]
        support, share = agreement(candidates, pose[None], settings.tolerance_m)
        members = _best_per_camera(candidates, np.where((share[0] >= settings.min_share) & free, support[0], 0.0))
    return members


def _assignment(cameras: int, candidates: Candidates, found: dict[int, Array]) -> Assignment:
    ids = sorted(found)
    place = np.full((len(ids), cameras), UNSEEN)
    for row, person in enumerate(ids):
        place[row, candidates.camera[found[person]]] = candidates.place[found[person]]
    return Assignment(person_id=np.array(ids, np.int64), place=place)
