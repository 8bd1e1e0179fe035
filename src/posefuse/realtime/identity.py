"""The persons of a live session: the tracker's tracks under ids that last."""

from __future__ import annotations

from collections.abc import Mapping

from posefuse.association import Identity, with_persons
from posefuse.core import Detections2D, Kind, Pose3D
from posefuse.tracking.online import CameraHealth, LiveSettings, Tracker

# poses of a track say something new about the body this often
_LEARN_NS = 30_000_000
_MEASURED_SHARE = 0.5


class NamedTracker:
    """A tracker whose poses carry persons; implements `Tracker`.

    A track that nobody can be named for yet is followed, and looked for by the views, but is not in `at`. With one person
    there is nothing to tell apart: tracks and persons are the same.
    """

    def __init__(self, tracker: Tracker, settings: LiveSettings) -> None:
        self._tracker, self._several = tracker, settings.max_people > 1
        self._identity = Identity(people_max=settings.max_people, lost_after_s=settings.lost_after_s)
        self._learnt_ns: int | None = None

    def add(self, detections: Detections2D) -> None:
        """See `Tracker.add`."""
        self._tracker.add(detections)

    def at(self, t_ns: int) -> Pose3D:
        """See `Tracker.at`; person_id holds persons."""
        pose = self._tracker.at(t_ns)
        if not self._several:
            return pose
        if self._learnt_ns is None or abs(t_ns - self._learnt_ns) >= _LEARN_NS:
            self._learnt_ns = t_ns
            self._identity = self._identity.after(_measured(pose))
        return with_persons(pose, [self._identity.person_of(track) for track in pose.person_id.tolist()])

    def looked_for(self, t_ns: int) -> Pose3D:
        """See `Tracker.looked_for`."""
        return self._tracker.looked_for(t_ns)

    @property
    def health(self) -> Mapping[str, CameraHealth]:
        """See `Tracker.health`."""
        return self._tracker.health


def _measured(pose: Pose3D) -> Pose3D:
    """The tracks that views measured lately: a prediction says nothing about a body."""
    share = (pose.kind == Kind.FUSED).sum(axis=1) / pose.kind.shape[1]
    kept = set(pose.person_id[share >= _MEASURED_SHARE].tolist())
    return with_persons(pose, [track if track in kept else -1 for track in pose.person_id.tolist()])
