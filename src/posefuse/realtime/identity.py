"""The persons of a live session: the tracker's tracks under ids that last."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from posefuse.association import CLOTHING_TRAITS, UNNAMED, Identity, median_clothing, with_persons
from posefuse.core import Detections2D, Kind, Pose3D
from posefuse.core.arrays import Array
from posefuse.tracking.online import MOTION, CameraStatistics, Evidence, LiveSettings, Tracker

# poses of a track add information about the body this often
_LEARN_NS = 30_000_000
_MEASURED_SHARE = 0.5
# colours that a camera saw longer ago are not those of now
_COLOUR_NS = 200_000_000


class NamedTracker:
    """A tracker whose poses carry persons; implements `Tracker`.

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
        """See `Tracker.looked_for`."""
        return self._tracker.looked_for(t_ns)

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
        for ended in set(self._colours) - set(pose.person_id.tolist()):
            del self._colours[ended]

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
