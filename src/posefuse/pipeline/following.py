"""First pass over a recording: find the people, follow them, and report to each view where to look next."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.association import AssociateSettings, assign
from posefuse.core import DetectionBatch, Detections2D, Kind, LookKind, Observations, Pose3D, Rig, Skeleton, Views
from posefuse.core.arrays import Array
from posefuse.core.observations import NOT_KEPT
from posefuse.fusion import FuseSettings, fuse

from .clock import StageClock
from .time_steps import TimeStep

Keep = Callable[[DetectionBatch], None]
# time steps between two searches that found no further person
_SEARCH_EVERY = 5
# a pose that gives the views their regions has this share of its keypoints
_GOOD_SHARE = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Followed:
    """The result of one time step.

    Attributes:
        batches: every look that the detector took, in order. chosen: index of the one that the people are taken from.
        person_ids: per entry of the chosen batch, the person of each detection.
        views: the people in every camera, each at its own exposure time. pose: the fused pose.
    """

    batches: tuple[DetectionBatch, ...]
    chosen: int
    person_ids: tuple[Array, ...]
    views: Views
    pose: Pose3D


@dataclass(frozen=True, eq=False, kw_only=True)
class _Seen:
    """The result of one look."""

    batch: DetectionBatch
    person_ids: tuple[Array, ...]
    views: Views
    pose: Pose3D


class Follower:
    """First pass over a recording: finds people, follows them, and reports to each view where to look next.

    While people are followed, the pose expected at a time step (constant velocity) gives each view its region. As long as
    fewer people are followed than asked for, the detector searches whole images: at once when a person has just been
    lost, then every few time steps. A view in which the search missed a person gets a second look where the others see
    the person.

    Args:
        skeleton: the detector's. rig: the cameras. associating, fusing: settings of the two.
        clock: adds up the seconds of each stage.
        keep: receives every answer of the detector as soon as it is there.
    """

    def __init__(
        self,
        *,
        skeleton: Skeleton,
        rig: Rig,
        associating: AssociateSettings,
        fusing: FuseSettings,
        clock: StageClock | None = None,
        keep: Keep | None = None,
    ) -> None:
        self._skeleton, self._rig, self._associating, self._fusing = skeleton, rig, associating, fusing
        self._clock, self._keep = clock or StageClock(), keep
        self._last_good: Pose3D | None = None
        self._newest: tuple[Pose3D, ...] = ()  # up to two good poses in a row
        self._search_due = 0
        self._batches: list[DetectionBatch] = []

    def follow(self, steps: Iterable[TimeStep]) -> Iterator[Followed]:
        """One result per time step."""
        iterator = iter(steps)
        for i in itertools.count():
            with self._clock.stage("decode"):
                step = next(iterator, None)
            if step is None:
                return
            yield self._step(i, step)

    def _step(self, i: int, step: TimeStep) -> Followed:
        self._batches = []
        expected = _expected(self._newest, step.t_ns) if self._newest else _no_person(self._skeleton, step.t_ns)
        seen = self._see(i, step, LookKind.EXPECTED, expected, self._last_good)
        if _people(seen.pose) < self._associating.max_people and i >= self._search_due:
            found = self._search(i, step)
            if _people(found.pose) > _people(seen.pose):
                seen = found
            else:
                self._search_due = i + _SEARCH_EVERY
        self._newest = (*self._newest[-1:], seen.pose) if _people(seen.pose) else ()
        self._last_good = seen.pose if self._newest else self._last_good
        chosen = self._batches.index(seen.batch)
        return Followed(batches=tuple(self._batches), chosen=chosen, person_ids=seen.person_ids, views=seen.views, pose=seen.pose)

    def _search(self, i: int, step: TimeStep) -> _Seen:
        """Look for people in whole images, then where a view missed one that others saw."""
        seen = self._see(i, step, LookKind.SEARCH, None, self._last_good)
        if not _people(seen.pose) or not _some_view_lacks_a_person(seen.views):
            return seen
        second = self._see(i, step, LookKind.SECOND, seen.pose, seen.pose)
        return second if _people(second.pose) >= _people(seen.pose) else seen

    def _see(self, i: int, step: TimeStep, kind: LookKind, expected: Pose3D | None, previous: Pose3D | None) -> _Seen:
        with self._clock.stage("detect"):
            batch = DetectionBatch(step=i, t_ns=step.t_ns, kind=kind, detections=step.look(kind, expected))
        self._batches.append(batch)
        if self._keep is not None:
            with self._clock.stage("store"):
                self._keep(batch)
        with self._clock.stage("fuse"):
            by_camera = {one.camera: one for one in batch.detections}
            absent = Detections2D.nobody("", step.t_ns, self._skeleton)
            detections = [by_camera.get(name) or replace(absent, camera=name) for name in self._rig.names]
            assignment = assign(detections, self._rig, self._associating, step.t_ns, previous)
            views = assignment.views(detections, step.t_ns)
            pose = fuse(views, self._rig, self._fusing, previous)
        place = {name: c for c, name in enumerate(self._rig.names)}
        person_ids = tuple(assignment.people_of(place[one.camera], len(one)) for one in batch.detections)
        return _Seen(batch=batch, person_ids=person_ids, views=views, pose=pose)


def observations_of(followed: Sequence[Followed], skeleton: Skeleton, rig: Rig) -> Observations:
    """All that the detector found, with the person of each detection."""
    batches, person_ids = [], []
    for one in followed:
        for place, batch in enumerate(one.batches):
            nobody = [np.full(len(found), NOT_KEPT) for found in batch.detections]
            batches.append(batch)
            person_ids.append(one.person_ids if place == one.chosen else nobody)
    return Observations.from_batches(skeleton, rig.names, batches, person_ids)


def _people(pose: Pose3D) -> int:
    """How many people are known well enough to give the views their regions."""
    return int(((pose.kind != Kind.MISSING).mean(axis=1) >= _GOOD_SHARE).sum()) if len(pose.person_id) else 0


def _some_view_lacks_a_person(views: Views) -> bool:
    return bool((np.nan_to_num(views.score).max(axis=2) == 0).any())


def _no_person(skeleton: Skeleton, t_ns: int) -> Pose3D:
    k = len(skeleton)
    none = np.zeros((0, k))
    return Pose3D(
        t_ns=t_ns,
        skeleton=skeleton,
        person_id=np.zeros(0),
        xyz_world=np.zeros((0, k, 3)),
        cov_world=np.zeros((0, k, 3, 3)),
        reproj_px=none,
        n_views=none,
        kind=none,
    )


def _expected(newest: tuple[Pose3D, ...], t_ns: int) -> Pose3D:
    """The newest pose carried on to t_ns at the velocity between the last two."""
    if len(newest) < 2 or not np.array_equal(newest[0].person_id, newest[1].person_id):
        return newest[-1]
    before, last = newest
    share = (t_ns - last.t_ns) / max(last.t_ns - before.t_ns, 1)
    step = (last.xyz_world - before.xyz_world) * share
    return replace(last, xyz_world=last.xyz_world + np.nan_to_num(step))
