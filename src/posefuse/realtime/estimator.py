"""From views to poses, without a clock and without a process: sessions, their replay and the warm-up use the same.

It joins what the stages bring: the tracker, whose tracks become persons under ids that last, joint centres, the whole-body fit,
and the gate before the outputs, which passes keypoints that are known well enough and were measured lately enough. A robot that
follows a frame is better off when the frame times out than when it flies. What is withheld is missing in every output alike,
and counted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from posefuse.association import CLOTHING_TRAITS, UNNAMED, Identity, associate, median_clothing, with_persons
from posefuse.core import Detections2D, JointCentres, Kind, LiveJointCentres, Pose3D, Rig, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.poses import worst_sigma_m
from posefuse.foundation.requests_to_end import interrupting_at_once
from posefuse.fusion import fuse, whitened_view
from posefuse.kinematics import JointTracker
from posefuse.kinematics.body import FEWEST_SEEN, LIVE_BODY, Length, LiveBody, LiveBodyRules, LiveRays, TrackedPoints
from posefuse.kinematics.joints import FrameBuffers
from posefuse.tracking import LearntLengths, at_joint_centres, usual_lengths
from posefuse.tracking.online import MOTION, CameraStatistics, Evidence, LiveMotion, LiveSettings, Model, Tracker
from posefuse.tracking.warm_up import made_up_detections

from .config import KeypointGateSettings, LiveConfig

# poses of a track add information about the body this often
_LEARN_NS = 30_000_000
_MEASURED_SHARE = 0.5
# colours that a camera saw longer ago are not those of now
_COLOUR_NS = 200_000_000


class NamedTracker:
    """A tracker whose poses carry persons.

    A track that no one can be named for yet is followed, and looked for by the views, but is not in `at`. With one person
    there is nothing to distinguish: tracks and persons are the same.
    """

    def __init__(self, tracker: Tracker, settings: LiveSettings) -> None:
        self._tracker, self._several = tracker, settings.max_people > 1
        self._identity = Identity(people_max=settings.max_people, lost_after_s=settings.lost_after_s)
        # poses call a keypoint measured for `measured_s` after its last view
        self._shown_ns = round(max(settings.shown_s - MOTION.measured_s, 0.0) * 1e9)
        self._learnt_ns: int | None = None
        # by track: when views last measured it, and the newest colours by camera with their times
        self._measured_ns: dict[int, int] = {}
        self._colours: dict[int, dict[str, tuple[int, Array]]] = {}

    def add(self, detections: Detections2D) -> Array:
        """See `Tracker.add`; tracks, not persons."""
        tracks = self._tracker.add(detections)
        if self._several:
            for place in np.flatnonzero(tracks != UNNAMED):
                colours = self._colours.setdefault(int(tracks[place]), {})
                colours[detections.camera] = (detections.t_ns, detections.clothing_lab[place])
        return tracks

    def at(self, t_ns: int) -> Pose3D:
        """See `Tracker.at`; person_id holds persons."""
        pose = self._tracker.at(t_ns)
        if not self._several:
            return pose
        if self._learnt_ns is None or abs(t_ns - self._learnt_ns) >= _LEARN_NS:
            self._learnt_ns = t_ns
            self._learn(pose)
        return with_persons(pose, [self._person_of(track, t_ns) for track in pose.person_id.tolist()])

    def looked_for(self, t_ns: int) -> Pose3D:
        """Every person that the views should look for at t_ns, including those without an identity so far."""
        return self._tracker.at(t_ns)

    def check(self) -> None:
        """See `Tracker.check`."""
        self._tracker.check()

    def evidence(self, t_ns: int) -> Mapping[int, Evidence]:
        """See `Tracker.evidence`; by person."""
        found = self._tracker.evidence(t_ns)
        if not self._several:
            return found
        persons = {self._person_of(track, t_ns): one for track, one in found.items()}
        return {person: one for person, one in persons.items() if person != UNNAMED}

    @property
    def health(self) -> Mapping[str, CameraStatistics]:
        """See `Tracker.health`."""
        return self._tracker.health

    def _learn(self, pose: Pose3D) -> None:
        seen = _measured(pose)
        tracks = seen.person_id.tolist()
        self._measured_ns |= dict.fromkeys(tracks, pose.t_ns)
        clothing = np.array([self._clothing(track, pose.t_ns) for track in tracks]).reshape(-1, CLOTHING_TRAITS)
        self._identity = self._identity.after(seen, clothing)
        for kept in (self._colours, self._measured_ns):
            for ended in set(kept) - set(pose.person_id.tolist()):
                del kept[ended]

    def _clothing(self, track: int, t_ns: int) -> Array:
        fresh = [lab for seen_ns, lab in self._colours.get(track, {}).values() if t_ns - seen_ns <= _COLOUR_NS]
        return median_clothing(np.array(fresh).reshape(-1, 3, 3))

    def _person_of(self, track: int, t_ns: int) -> int:
        out_of_sight_ns = t_ns - self._measured_ns.get(track, t_ns)
        return self._identity.person_of(track) if out_of_sight_ns <= self._shown_ns else UNNAMED


def _measured(pose: Pose3D) -> Pose3D:
    """The tracks that views measured lately: a prediction has no information about a body."""
    share = (pose.kind == Kind.FUSED).sum(axis=1) / pose.kind.shape[1]
    kept = set(pose.person_id[share >= _MEASURED_SHARE].tolist())
    return with_persons(pose, [track if track in kept else -1 for track in pose.person_id.tolist()])


# so far below a limit rounding does not matter
_CLEARLY = 0.99


class KeypointGate:
    """Passes poses on in the order of their times.

    Attributes:
        keypoints, people: how many were there, and how many of them were withheld: (all, withheld). A person is withheld when
            no keypoint is left.
    """

    def __init__(self, rules: KeypointGateSettings) -> None:
        self._rules = rules
        self.keypoints = self.people = (0, 0)
        # by person: when each keypoint was last measured
        self._measured_ns: dict[int, Array] = {}

    def passed(self, pose: Pose3D) -> Pose3D:
        """The pose without what is withheld."""
        if not len(pose.person_id):
            self._measured_ns = {}
            return pose
        there = pose.kind != Kind.MISSING
        good = there & _known_to(pose.cov_world, self._rules.sigma_m) & self._fresh(pose)
        left = good.any(axis=1)
        self.keypoints = _counted(self.keypoints, there, good)
        self.people = _counted(self.people, there.any(axis=1), left)
        if good.all():
            return pose
        return replace(
            pose,
            xyz_world=np.where(good[..., None], pose.xyz_world, np.nan),
            cov_world=np.where(good[..., None, None], pose.cov_world, np.nan),
            reproj_px=np.where(good, pose.reproj_px, np.nan),
            n_views=np.where(good, pose.n_views, 0),
            kind=np.where(good, pose.kind, Kind.MISSING),
        ).people(left)

    def figures(self) -> dict[str, float]:
        """Shares of what was withheld."""
        return {name: cut / of if of else 0.0 for name, (of, cut) in (("keypoints", self.keypoints), ("people", self.people))}

    def _fresh(self, pose: Pose3D) -> Array:
        """(N, K) bool: measured not too long ago."""
        before, now = self._measured_ns, {}
        for person, kind in zip(pose.person_id.tolist(), pose.kind, strict=True):
            # who is new was measured just now
            last = before.get(person, np.full(kind.shape, pose.t_ns))
            now[person] = np.where((kind == Kind.PREDICTED) & (last <= pose.t_ns), last, pose.t_ns)
        self._measured_ns = now
        oldest_ns = pose.t_ns - round(self._rules.unmeasured_s * 1e9)
        measured = np.array([now[person] for person in pose.person_id.tolist()]).reshape(pose.kind.shape)
        return np.asarray(measured >= oldest_ns)


def _known_to(cov: Array, sigma_m: float) -> Array:
    """(...) bool: `worst_sigma_m` of covariances (..., 3, 3) is at most `sigma_m`."""
    # no eigenvalue is larger than the root of the sum of squares: mostly there is none to be computed
    squares = np.einsum("...ij,...ij->...", cov, cov)
    known = np.asarray(squares < (_CLEARLY * sigma_m**2) ** 2)
    if not known.all():
        known[~known] = worst_sigma_m(cov[~known]) <= sigma_m
    return known


def _counted(before: tuple[int, int], there: Array, good: Array) -> tuple[int, int]:
    count = int(there.sum())
    return before[0] + count, before[1] + count - int((there & good).sum())


# a second: until then every kernel of the tracker has been used
_WARM_UP_STEPS = 30
# NumPy compares with a number ten times as quickly as with a member of an enumeration
_FUSED = int(Kind.FUSED)


class Centring:
    """Moves poses to joint centres, and learns on the way how long people's segments are.

    A pose is made of all cameras' views; should they come from networks with different tables, the table of the rig's first
    camera that has one counts.
    """

    def __init__(self, cameras: Sequence[str], wanted: bool) -> None:
        self._tables: dict[str, JointCentres | None] = dict.fromkeys(cameras)
        self._wanted = wanted
        self._lengths: LearntLengths | None = None

    def learn(self, centres: LiveJointCentres) -> None:
        """What is known of some cameras, from now on."""
        self._tables.update({name: centres.table for name in centres.cameras if name in self._tables})
        table = next((table for table in self._tables.values() if table is not None), None)
        if table is None:
            self._lengths = None
        elif self._lengths is None or self._lengths.table != table:
            self._lengths = LearntLengths(table)

    @property
    def made_by(self) -> dict[str, str]:
        """Which table each camera's network has; only those that have one, and nothing where it is not wanted."""
        return {name: table.made_by for name, table in self._tables.items() if table is not None and self._wanted}

    @property
    def fitted(self) -> bool:
        """Whether poses are moved by a table that was fitted to a detector."""
        return self._wanted and self._lengths is not None

    def moved(self, pose: Pose3D) -> Pose3D:
        """The next pose at joint centres, where they are wanted and known; poses come in the order of their times."""
        if self._lengths is None or not self._wanted:
            return pose
        lengths = self._lengths.step(pose)
        return at_joint_centres(pose, self._lengths.table, lengths) if len(lengths) else pose


class LiveSkeletons:
    """Everybody's skeleton; people who are gone are forgotten."""

    def __init__(self, rig: Rig, skeleton: Skeleton, config: LiveConfig, rules: LiveBodyRules = LIVE_BODY) -> None:
        self._skeleton, self._config, self._rules = skeleton, config, rules
        self._work = FrameBuffers(skeleton)
        self._prior = usual_lengths()
        self._projections = np.stack([np.column_stack([c.cam_from_world.matrix(), c.cam_from_world.xyz]) for c in rig])
        self._people: dict[int, LiveBody] = {}

    def wanted(self, centring: Centring) -> bool:
        """Whether poses are to be fitted: always, or only with offsets of joint centres that were fitted to the detector."""
        return self._config.body == "on" or centring.fitted

    def step(self, tracker: NamedTracker, pose: Pose3D) -> Pose3D:
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
        return LiveRays.moved(self._projections[seen.camera], seen.z, seen.inverse_var, then=seen.then_world, now=centred)


class Estimator:
    """Follows people through views, in the order they come; poses are asked for in the order of their times.

    Attributes:
        tracker: follows the landmarks of the networks. centring: moves poses to joint centres. bodies: puts them on people's
            skeletons; None where that is off. gate: withholds what is not known well enough.
    """

    def __init__(
        self, tracker: NamedTracker, centring: Centring, bodies: LiveSkeletons | None = None, gate: KeypointGate | None = None
    ) -> None:
        self.tracker, self.centring, self.bodies = tracker, centring, bodies
        self.gate = gate or KeypointGate(KeypointGateSettings())

    def add(self, view: Detections2D) -> None:
        """One camera's detections in one frame."""
        self.tracker.add(view)

    def at(self, t_ns: int) -> Pose3D:
        """The pose that is sent out for a time."""
        return self.shown(self.tracker.at(t_ns))

    def shown(self, landmarks: Pose3D) -> Pose3D:
        """The tracker's newest pose as it is sent out."""
        return self.gate.passed(self.placed(landmarks))

    def placed(self, landmarks: Pose3D) -> Pose3D:
        """The tracker's newest pose at joint centres, on people's skeletons where these are wanted; nothing is withheld."""
        pose = self.centring.moved(landmarks)
        if self.bodies is None or not self.bodies.wanted(self.centring):
            return pose
        return self.bodies.step(self.tracker, pose)

    def looked_for(self, t_ns: int) -> Pose3D:
        """Where cameras should look for people; landmarks of the networks."""
        return self.tracker.looked_for(t_ns)

    def check(self) -> None:
        """What takes up to most of an output period: after an output, before the next views."""
        self.tracker.check()


def warmed_up(
    rig: Rig,
    skeleton: Skeleton,
    config: LiveConfig,
    stopped: Sequence[str] = (),
    *,
    motion: LiveMotion = MOTION,
    rules: LiveBodyRules = LIVE_BODY,
) -> Estimator:
    """A new estimator whose kernels are compiled: one made for the purpose has followed a made-up person.

    Raises:
        KeyboardInterrupt: `stopped` has an entry, or gets one; on a new machine kernels take more than a minute.
    """
    at_once = replace(LIVE_BODY, learn_s=LIVE_BODY.sample_every_s * FEWEST_SEEN)
    made_up = _new(rig, skeleton, replace(config, body="off" if config.body == "off" else "on"), MOTION, at_once)
    with interrupting_at_once():
        if stopped:
            raise KeyboardInterrupt
        for detections in made_up_detections(rig, skeleton, _WARM_UP_STEPS, start_ns=10**15):
            for view in detections:
                made_up.add(view)
                pose = made_up.at(view.t_ns + 20_000_000)
        no_offsets = JointCentres(made_by="", offsets={})
        at_joint_centres(pose, no_offsets, no_offsets.usual)
        JointTracker(skeleton).step(pose)
    return _new(rig, skeleton, config, motion, rules)


def _new(rig: Rig, skeleton: Skeleton, config: LiveConfig, motion: LiveMotion, rules: LiveBodyRules) -> Estimator:
    associating = replace(config.associate, max_people=config.track.max_people)
    alone = {camera.name: Rig((camera,)) for camera in rig}

    def solve(views: Sequence[Detections2D]) -> Pose3D:
        return fuse(associate(views, rig, associating), rig, config.fuse)

    def whitened(view: Detections2D) -> tuple[Array, Array, Array]:
        return whitened_view(view, alone[view.camera], config.fuse)

    tracker = Tracker(Model(rig, skeleton, config.track, motion), solve, lambda views: fuse(views, rig, config.fuse), whitened)
    bodies = None if config.body == "off" else LiveSkeletons(rig, skeleton, config, rules)
    centring, gate = Centring(rig.names, config.joint_centres), KeypointGate(config.gate)
    return Estimator(NamedTracker(tracker, config.track), centring, bodies, gate)
