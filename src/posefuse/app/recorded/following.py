"""First pass over a recording: find the people, follow them, and tell each view where to look next."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from posefuse.associate import AssociateSettings, associate
from posefuse.core import Detections2D, Kind, Pose3D, Rig, Views
from posefuse.fuse import FuseSettings, fuse

from .clock import StageClock
from .instants import Instant

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
    instants: Iterable[Instant], rig: Rig, associating: AssociateSettings, fusing: FuseSettings, clock: StageClock
) -> Iterator[Seen]:
    """One `Seen` per instant.

    While people are followed, the pose expected at an instant (constant velocity) gives each view its region. When they
    are lost, and at the start, the 2D estimator searches; views in which it found nobody get a second look at where the
    others see the person.
    """
    last_good: Pose3D | None = None
    newest: tuple[Pose3D, ...] = ()  # up to two good poses in a row
    iterator = iter(instants)
    while True:
        with clock.stage("decode"):
            instant = next(iterator, None)
        if instant is None:
            return
        expected = _expected(newest, instant.t_ns)
        searching = expected is None
        seen = _see(instant, expected, last_good, rig, associating, fusing, clock)
        if not _good(seen.pose) and not searching:
            searching = True
            seen = _see(instant, None, last_good, rig, associating, fusing, clock)
        if searching and _good(seen.pose) and _some_view_lacks_the_person(seen.views):
            second = _see(instant, seen.pose, seen.pose, rig, associating, fusing, clock)
            seen = second if _good(second.pose) else seen
        newest = (*newest[-1:], seen.pose) if _good(seen.pose) else ()
        last_good = seen.pose if newest else last_good
        yield seen


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


def _good(pose: Pose3D) -> bool:
    return len(pose.person_id) > 0 and bool((pose.kind != Kind.MISSING).mean(axis=1).max() >= _GOOD_SHARE)


def _some_view_lacks_the_person(views: Views) -> bool:
    return bool((np.nan_to_num(views.score).max(axis=(0, 2)) == 0).any())


def _expected(newest: tuple[Pose3D, ...], t_ns: int) -> Pose3D | None:
    """The newest pose carried on to t_ns at the velocity between the last two."""
    if len(newest) < 2 or not np.array_equal(newest[0].person_id, newest[1].person_id):
        return newest[-1] if newest else None
    before, last = newest
    share = (t_ns - last.t_ns) / max(last.t_ns - before.t_ns, 1)
    step = (last.xyz_world - before.xyz_world) * share
    return replace(last, xyz_world=last.xyz_world + np.nan_to_num(step))
