"""First pass over a recording: find the people, follow them, and tell each view where to look next."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from posefuse.association import AssociateSettings, associate
from posefuse.core import Detections2D, Kind, Pose3D, Rig, Skeleton, Views
from posefuse.fusion import FuseSettings, fuse

from .clock import StageClock
from .images import Instant

# instants between two searches that found nobody new
_SEARCH_EVERY = 5
# a pose worth telling the views where to look: this share of its keypoints is there
_GOOD_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Seen:
    """What came of one instant.

    Attributes:
        views: the people in every camera. frame_t_ns: (C,) time of each camera's own frame; views.t_ns where it has none.
        pose: the fused pose.
    """

    views: Views
    frame_t_ns: tuple[int, ...]
    pose: Pose3D


def follow(
    instants: Iterable[Instant],
    skeleton: Skeleton,
    rig: Rig,
    associating: AssociateSettings,
    fusing: FuseSettings,
    clock: StageClock,
) -> Iterator[Seen]:
    """One `Seen` per instant.

    While people are followed, the pose expected at an instant (constant velocity) gives each view its region. As long as
    fewer people are followed than asked for, the 2D estimator searches whole images: at once when somebody has just been
    lost, then every few instants. A view in which the search missed somebody gets a second look at where the others see
    the person.
    """
    last_good: Pose3D | None = None
    newest: tuple[Pose3D, ...] = ()  # up to two good poses in a row
    search_due = 0
    iterator = iter(instants)
    for i in itertools.count():
        with clock.stage("decode"):
            instant = next(iterator, None)
        if instant is None:
            return
        expected = _expected(newest, instant.t_ns) if newest else _nobody(skeleton, instant.t_ns)
        seen = _see(instant, expected, last_good, rig, associating, fusing, clock)
        if _people(seen.pose) < associating.max_people and i >= search_due:
            found = _search(instant, last_good, rig, associating, fusing, clock)
            if _people(found.pose) > _people(seen.pose):
                seen = found
            else:
                search_due = i + _SEARCH_EVERY
        newest = (*newest[-1:], seen.pose) if _people(seen.pose) else ()
        last_good = seen.pose if newest else last_good
        yield seen


def _search(
    instant: Instant,
    last_good: Pose3D | None,
    rig: Rig,
    associating: AssociateSettings,
    fusing: FuseSettings,
    clock: StageClock,
) -> Seen:
    """Look for people in whole images, then where a view missed one that others saw."""
    seen = _see(instant, None, last_good, rig, associating, fusing, clock)
    if not _people(seen.pose) or not _some_view_lacks_a_person(seen.views):
        return seen
    second = _see(instant, seen.pose, seen.pose, rig, associating, fusing, clock)
    return second if _people(second.pose) >= _people(seen.pose) else seen


def _see(
    instant: Instant,
    expected: Pose3D | None,
    previous: Pose3D | None,
    rig: Rig,
    associating: AssociateSettings,
    fusing: FuseSettings,
    clock: StageClock,
) -> Seen:
    with clock.stage("detect"):
        detections = instant.look(expected)
    with clock.stage("fuse"):
        together = [_at(d, instant.t_ns) for d in detections]
        views = associate(together, rig, associating, previous)
        pose = fuse(views, rig, fusing, previous)
    times = tuple(d.t_ns if len(d) else instant.t_ns for d in detections)
    return Seen(views, times, pose)


def _at(detections: Detections2D, t_ns: int) -> Detections2D:
    return detections if detections.t_ns == t_ns else replace(detections, t_ns=t_ns)


def _people(pose: Pose3D) -> int:
    """How many people are known well enough to tell the views where to look."""
    return int(((pose.kind != Kind.MISSING).mean(axis=1) >= _GOOD_SHARE).sum()) if len(pose.person_id) else 0


def _some_view_lacks_a_person(views: Views) -> bool:
    return bool((np.nan_to_num(views.score).max(axis=2) == 0).any())


def _nobody(skeleton: Skeleton, t_ns: int) -> Pose3D:
    k = len(skeleton)
    none = np.zeros((0, k))
    return Pose3D(t_ns, skeleton, np.zeros(0), np.zeros((0, k, 3)), np.zeros((0, k, 3, 3)), none, none, none)


def _expected(newest: tuple[Pose3D, ...], t_ns: int) -> Pose3D:
    """The newest pose carried on to t_ns at the velocity between the last two."""
    if len(newest) < 2 or not np.array_equal(newest[0].person_id, newest[1].person_id):
        return newest[-1]
    before, last = newest
    share = (t_ns - last.t_ns) / max(last.t_ns - before.t_ns, 1)
    step = (last.xyz_world - before.xyz_world) * share
    return replace(last, xyz_world=last.xyz_world + np.nan_to_num(step))
