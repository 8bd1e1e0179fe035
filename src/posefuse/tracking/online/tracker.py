"""Every view counts at its own time; the pose is predicted to the time it is wanted for. Nothing else remembers in a session."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from posefuse.core import Detections2D, Pose3D
from posefuse.core.arrays import Array, median_apart
from posefuse.core.duplicate_share import DUPLICATE_SHARE
from posefuse.core.duplicates import duplicates

from .admission import Admission, CameraStatistics
from .cross_check import CrossCheck, Fuse
from .kernels.pose import PoseRow
from .kernels.rays import person_agreement
from .kernels.state import KeypointRays
from .optics import Whitened, rays_of
from .person import Evidence, Model, Person

# one Detections2D per camera of the rig, in its order, of about one moment -> the people in them
Solve = Callable[[Sequence[Detections2D]], Pose3D]

# detections used per view, the surest first
_MOST_DETECTIONS = 16
# a detection is this person when so large a share of its keypoints is so near, at the body, to where they are expected
_TOLERANCE_M, _CLAIMED_SHARE = 0.2, 0.4
# a person is looked for in views no one claimed that are not older than this against the newest, so often at most
_BIRTH_WINDOW_NS, _BIRTH_EVERY_NS = 120_000_000, 50_000_000
# chosen, not fitted: at 30 frames/s the first of the views waits for the others without being replaced by its next one
_BIRTH_WAIT_NS = 20_000_000
# who was not measured by two cameras (or one with depth) for so long may be found again within this distance
_STALE_NS, _FOUND_AGAIN_M = 200_000_000, 1.0
_SAME_PERSON_M = 0.3
# chosen, not fitted: least keypoints of a newcomer, and least share of the skeleton; from 17 keypoints on the share asks for more
_LEAST_POINTS, _LEAST_SHARE = 5, 0.3
# how fast a person may move during the views a birth is made from
_BIRTH_SPEED_M_S = 1.5
# chosen, not fitted: detections of fewer keypoints are not kept for a birth, which needs more
_LEAST_KEYPOINTS = 3
# the cameras' views of a person are compared so often
_CHECK_EVERY_NS = 200_000_000
# of a sprinter: what is faster is no body any more
_FASTEST_M_S = 13.0


class Tracker:
    """Follows people through single views. No clock inside: the same calls give the same answers.

    A Kalman filter bank per keypoint; see `kernels`. A person is born from the robust solve of views no one claimed.

    Args:
        model: the cameras, the skeleton of every view, and how people move.
        solve: association and fusion of one time step, from one view of every camera (empty for those that have none). New
            people come from it.
        fuse: fusion of one time step alone, of views that are known to show the same people.
        whitened: a view without its lens, as fusion takes it.
    """

    def __init__(self, model: Model, solve: Solve, fuse: Fuse, whitened: Whitened) -> None:
        rig = model.rig
        self._model, self._solve, self._fuse, self._whitened = model, solve, fuse, whitened
        self._admission = Admission(rig, model.skeleton, model.settings.lag_s)
        self._place = {name: c for c, name in enumerate(rig.names)}
        self._people: list[Person] = []
        self._checks: dict[Person, CrossCheck] = {}
        self._unclaimed: dict[str, Detections2D] = {}
        self._tried_ns: int | None = None
        self._restarts = 0
        self._asked = False
        self._next_id = 0

    def add(self, detections: Detections2D) -> Array:
        """Everybody one camera saw at its own time; late or out of order within the lag buffer, people in any order.

        Returns:
            (P,) the track that each of them was taken for; -1: none.

        Raises:
            ShapeError: a camera the rig does not have, or another skeleton. Wrong times are no error: see `health`.
        """
        tracks = np.full(len(detections), -1)
        if not self._admission.admits(detections):
            return tracks
        if self._admission.restarts != self._restarts:
            self._restarts, self._tried_ns = self._admission.restarts, None
            self._people.clear()
            self._unclaimed.clear()
        looked_at = _surest(detections)
        detections = detections if len(looked_at) == len(detections) else detections.people(looked_at)
        camera = self._admission.cameras[detections.camera]
        c = self._place[detections.camera]
        rays, depth_m = rays_of(detections, self._model.rig.cameras[c], c, self._whitened)
        claims = self._claims(rays, detections.t_ns)
        for person, p in claims:
            wrong = self._checks[person].keep(detections.people(np.array([p])))
            seen = KeypointRays(rays.camera, *(plane[p] for plane in rays[1:]))
            seen = seen._replace(z=np.where(wrong[:, None], np.nan, seen.z))
            found = person.add(detections.t_ns, seen, None if depth_m is None else depth_m[p])
            if found is not None:
                camera.count(found)
                tracks[looked_at[p]] = person.id
        self._cross_check(detections.t_ns)
        if self._model.settings.max_people > 1:
            # synchronised views wait for each other until the next frame, which takes the place of this camera's last one
            self._look_for_newcomers()
        self._keep_unclaimed(detections, {p for _, p in claims})
        self._forget()
        self._look_for_newcomers()
        return tracks

    def _cross_check(self, t_ns: int) -> None:
        """At most one person after each output: with the first view, unless `check` comes before it."""
        if not self._people or not self._asked:
            return
        self._asked = False
        person = min(self._people, key=lambda one: self._checks[one].checked_ns)
        if t_ns - self._checks[person].checked_ns >= _CHECK_EVERY_NS:
            self._checks[person].check(person, t_ns)

    def at(self, t_ns: int) -> Pose3D:
        """Everybody who is tracked, at t_ns; NaN where lost. See `LiveMotion.measured_s` for kind FUSED and PREDICTED.

        With several people, person_id numbers tracks: a person who was lost for long gets another number. Times older than the
        lag buffer are forgotten: no person.

        n_views counts the cameras, and reproj_px is over the views, of the last `LiveMotion.measured_s`.
        """
        self._admission.asked(t_ns)
        self._asked = True
        n, k = len(self._people), len(self._model.skeleton)
        xyz, cov, reproj = np.empty((n, k, 3)), np.empty((n, k, 3, 3)), np.empty((n, k))
        n_views, kind = np.zeros((2, n, k), np.uint8)
        ids: list[int] = []
        for person in self._people:
            if person.pose_into(t_ns, PoseRow(*(plane[len(ids)] for plane in (xyz, cov, reproj, n_views, kind)))):
                ids.append(person.id)
        return Pose3D(
            t_ns=t_ns, skeleton=self._model.skeleton, person_id=np.array(ids, np.int64), xyz_world=xyz[: len(ids)],
            cov_world=cov[: len(ids)], reproj_px=reproj[: len(ids)], n_views=n_views[: len(ids)], kind=kind[: len(ids)],
        )  # fmt: skip

    def check(self) -> None:
        """Do what takes longer and can wait, the cross-check: for callers who have time now, just after an output.

        Work that is due and was not done here is done by the next `add`, and delays it by milliseconds. The later after an output
        it begins, the more often the next one waits for it.
        """
        if self._admission.newest_ns is not None:
            self._cross_check(self._admission.newest_ns)

    def evidence(self, t_ns: int) -> Mapping[int, Evidence]:
        """By person_id as in `at`, what the pose at t_ns rests on."""
        return {person.id: person.evidence(t_ns) for person in self._people}

    @property
    def health(self) -> Mapping[str, CameraStatistics]:
        """By camera name, every camera of the rig."""
        admission = self._admission
        return {name: camera.statistics(admission.newest_ns) for name, camera in admission.cameras.items()}

    def _claims(self, rays: KeypointRays, t_ns: int) -> list[tuple[Person, int]]:
        """Association in one view: pairs of person and detection, each at most once, with the greatest support of all."""
        if not self._people or not len(rays.z):
            return []
        session = self._model.arrays
        support, share = np.empty((2, len(self._people), len(rays.z)))
        for n, person in enumerate(self._people):
            means, sigmas = person.expected(t_ns)
            person_agreement(
                session.cameras[rays.camera], means, sigmas, rays.z, session.mirror, _TOLERANCE_M, support[n], share[n]
            )  # fmt: skip
        support = np.where(share >= _CLAIMED_SHARE, support, 0.0)
        rows, places = linear_sum_assignment(-support) if support.size > 1 else ([0], [0])
        return [(self._people[n], int(p)) for n, p in zip(rows, places, strict=True) if support[n, p] > 0]

    def _keep_unclaimed(self, detections: Detections2D, claimed: set[int]) -> None:
        left = [p for p in range(len(detections)) if p not in claimed]
        if left:
            enough = (np.isfinite(detections.xy_img[..., 0]) & (detections.score > 0)).sum(axis=1) >= _LEAST_KEYPOINTS
            left = [p for p in left if enough[p]]
        before = self._unclaimed.get(detections.camera)
        if before is not None and before.t_ns > detections.t_ns:
            return
        self._unclaimed.pop(detections.camera, None)
        if left:
            self._unclaimed[detections.camera] = detections.people(np.array(left))

    def _forget(self) -> None:
        newest_ns = self._admission.newest_ns
        assert newest_ns is not None
        settings = self._model.settings
        lost_ns, alone_ns = newest_ns - round(settings.lost_after_s * 1e9), newest_ns - round(self._model.motion.alone_s * 1e9)
        self._people = [
            p for p in self._people if p.measured_ns >= lost_ns and p.crossed_ns >= alone_ns and p.speed_m_s < _FASTEST_M_S
        ]
        self._checks = {person: self._checks[person] for person in self._people}
        for person in self._people:
            person.forget(newest_ns - round(settings.lag_s * 1e9))

    def _look_for_newcomers(self) -> None:
        newest_ns = self._admission.newest_ns
        assert newest_ns is not None
        fresh = [person for person in self._people if newest_ns - person.crossed_ns <= _STALE_NS]
        views = {name: one for name, one in self._unclaimed.items() if newest_ns - one.t_ns <= _BIRTH_WINDOW_NS}
        enough = len(views) > 1 or any(one.depth_m is not None for one in views.values())
        if len(fresh) >= self._model.settings.max_people or not enough:
            return
        if self._tried_ns is not None and abs(newest_ns - self._tried_ns) < _BIRTH_EVERY_NS:
            return
        several = self._model.settings.max_people > 1 and len(views) < len(self._place)
        # among several people two views alone may meet in bodies that do not exist: wait for the other views
        if several and newest_ns - min(one.t_ns for one in views.values()) < _BIRTH_WAIT_NS:
            return
        self._tried_ns = newest_ns
        skeleton = self._model.skeleton
        together = [
            replace(views[name], t_ns=newest_ns) if name in views else Detections2D.empty(name, newest_ns, skeleton)
            for name in self._place
        ]
        pose = self._solve(together)
        times_ns = [one.t_ns for one in views.values()]
        t_ns = sum(times_ns) // len(times_ns)
        spread_m = _BIRTH_SPEED_M_S * (max(times_ns) - min(times_ns)) / 2 * 1e-9
        for xyz, cov in zip(pose.xyz_world, pose.cov_world, strict=True):
            self._welcome(t_ns, np.array(xyz), cov + spread_m**2 * np.eye(3), fresh)

    def _welcome(self, t_ns: int, xyz: Array, cov: Array, fresh: list[Person]) -> None:
        there = np.isfinite(xyz[:, 0]).sum()
        if there < max(_LEAST_POINTS, _LEAST_SHARE * len(xyz)):
            return
        if any(median_apart(person.expected(t_ns)[0], xyz) < _SAME_PERSON_M for person in fresh):
            return
        stale = {median_apart(person.expected(t_ns)[0], xyz): person for person in self._people if person not in fresh}
        near_m = min(stale, default=np.inf)
        if near_m < _FOUND_AGAIN_M:
            self._people.remove(stale[near_m])
            number = stale[near_m].id
        else:
            if len(self._people) >= self._model.settings.max_people:
                if self._model.settings.max_people == 1 or not stale:
                    return
                # one camera alone may have led this track away from its person; several agree on the newcomer
                self._people.remove(min(stale.values(), key=lambda person: person.crossed_ns))
            number = self._next_id
            # with one person a later track is the same person; with several it may be any of them
            self._next_id += self._model.settings.max_people > 1
        self._people.append(Person(self._model, number, t_ns, xyz, cov))
        self._checks[self._people[-1]] = CrossCheck(self._model, self._fuse)
        self._people.sort(key=lambda person: person.id)
        fresh.append(next(person for person in self._people if person.id == number))


def _surest(detections: Detections2D) -> Array:
    """Places of at most `_MOST_DETECTIONS` detections (one or more), in their order; a body that is there several times, once."""
    if len(detections) < 2:
        return np.arange(len(detections))
    once = np.flatnonzero(~duplicates(detections, DUPLICATE_SHARE))
    score = np.nan_to_num(detections.score[once]).sum(axis=1)
    return np.sort(once[np.argsort(-score, kind="stable")[:_MOST_DETECTIONS]])
