"""The whole-body fit of a live session: from the tracker's poses and rays to the skeletons of its people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from posefuse.core import Kind, Pose3D, Rig, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.kinematics.body import LIVE_BODY, Length, LengthPrior, LiveBody, LiveBodyRules, LiveRays, TrackedPoints
from posefuse.kinematics.joints import FrameBuffers
from posefuse.tracking import usual_lengths
from posefuse.tracking.online import Evidence, Tracker

from .config import LiveConfig
from .joint_centres import Centring

# NumPy compares with a number ten times as quickly as with a member of an enumeration
_FUSED = int(Kind.FUSED)


class LiveSkeletons:
    """Everybody's skeleton; people who are gone are forgotten."""

    def __init__(self, rig: Rig, skeleton: Skeleton, config: LiveConfig, rules: LiveBodyRules = LIVE_BODY) -> None:
        self._skeleton, self._config, self._rules = skeleton, config, rules
        self._work = FrameBuffers(skeleton, config.joints)
        mean_m, cov_m2 = usual_lengths()
        self._prior = LengthPrior(names=tuple(SEGMENT_ENDS), mean_m=mean_m, cov_m2=cov_m2)
        self._projections = np.stack([np.column_stack([c.cam_from_world.matrix(), c.cam_from_world.xyz]) for c in rig])
        self._people: dict[int, LiveBody] = {}

    def wanted(self, centring: Centring) -> bool:
        """Whether poses are to be fitted: always, or only with offsets of joint centres that were fitted to the detector."""
        return self._config.body == "on" or centring.fitted

    def step(self, tracker: Tracker, pose: Pose3D) -> Pose3D:
        """The next pose, with the keypoints of the people who have a fitted skeleton; the others are as they were.

        Keypoints that are missing stay missing. Covariances are those of the tracked keypoints, as the fit does not make the
        errors smaller that all views share, and larger where views disagree: networks are as sure of what they invent behind a
        screen as of what they see.

        Args:
            tracker: whose pose it is. pose: at joint centres.
        """
        t_ns, before = pose.t_ns, self._people
        self._people = {person: before.get(person) or self._new() for person in pose.person_id.tolist()}
        wanting = [person for person, body in self._people.items() if body.wants_rays(t_ns)]
        evidence = tracker.evidence(t_ns) if wanting else {}
        xyz, cov = pose.xyz_world.copy(), pose.cov_world.copy()
        for n, (person, body) in enumerate(self._people.items()):
            tracked = TrackedPoints(t_ns=t_ns, xyz=xyz[n].copy(), cov=pose.cov_world[n], measured=pose.kind[n] == _FUSED)
            seen = evidence.get(person) if person in wanting else None
            rays = None if seen is None else self._rays(seen, tracked.xyz)
            fitted = body.step(tracked, rays)
            if fitted is not None:
                xyz[n] = fitted
            cov[n] *= body.disagreement[:, None, None]
        return replace(pose, xyz_world=xyz, cov_world=cov)

    @property
    def lengths(self) -> Mapping[int, Mapping[str, Length]]:
        """By person, the segment lengths learnt so far."""
        return {
            person: body.learnt.body.lengths for person, body in self._people.items() if body.learnt.body is not None
        }  # fmt: skip

    def _new(self) -> LiveBody:
        return LiveBody(self._skeleton, self._config.whole_body, self._rules, self._prior, self._work)

    def _rays(self, seen: Evidence, centred: Array) -> LiveRays:
        """Rays as they would be now, to joint centres: moved by what lies between the landmark then and the centre now."""
        return LiveRays.moved(
            self._projections[seen.camera], seen.z, seen.inverse_var, then=seen.then_world, now=centred,
            checked_ns=seen.checked_ns, checked_world=centred + seen.away_world,
        )  # fmt: skip


def pose_for_output(tracker: Tracker, landmarks: Pose3D, centring: Centring, bodies: LiveSkeletons | None) -> Pose3D:
    """The tracker's newest pose at joint centres, on people's skeletons if these are wanted."""
    pose = centring.moved(landmarks)
    return pose if bodies is None or not bodies.wanted(centring) else bodies.step(tracker, pose)
