"""How long the segments of people are, learnt while they are followed live: from the past alone, a few numbers per person."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import JointCentres, Kind, Pose3D
from posefuse.core.arrays import Array
from posefuse.core.joint_centres import SEGMENT_ENDS

from .joint_centres import MOST_LONGER_M, at_joint_centres
from .segments import lengths_at

_S = len(SEGMENT_ENDS)
# a new person counts as usual, as surely as if that had been seen for so long; see `bench/live_centres.py`
USUAL_S = 0.3
# older measurements fade, in case of an undetected change of person
_MEMORY_S = 60.0
# poses this close in time add no information
_EVERY_NS = 50_000_000
# one pose stands for no longer than this, should the ones before it be missing
_LONGEST_NS = 100_000_000
# only ends known as well as this teach lengths, standard deviation
_SURE_M = 0.05


@dataclass
class _Learnt:
    """Of one person: metres (S,) longer than usual, from how many seconds (S,), up to when."""

    longer: Array
    seconds: Array
    t_ns: int


class LearntLengths:
    """Means over time of the lengths in live poses, drawn to the table's usual ones until they have been seen for long enough.

    So poses do not jump: lengths change gradually from average to measured ones. People who leave are forgotten.
    """

    def __init__(self, table: JointCentres, usual_s: float = USUAL_S) -> None:
        self.table, self._usual_s = table, usual_s
        self._people: dict[int, _Learnt] = {}

    def step(self, pose: Pose3D) -> Array:
        """(N, S) metres of everybody's segments between joint centres, from the landmarks of the next pose and all before."""
        before, self._people = self._people, {}
        for person in pose.person_id.tolist():
            known = before.get(person)
            if known is None or known.t_ns > pose.t_ns:
                known = _Learnt(np.zeros(_S), np.zeros(_S), pose.t_ns)
            self._people[person] = known
        everybody = list(self._people.values())
        due = [n for n, person in enumerate(everybody) if pose.t_ns - person.t_ns >= _EVERY_NS]
        if due:
            centred = at_joint_centres(pose, self.table, self.table.usual)
            seen = lengths_at(_well_known(centred), pose.skeleton)
            for n in due:
                self._learn(everybody[n], seen[n], pose.t_ns)
        return np.array([self.table.usual + person.longer for person in everybody]).reshape(-1, _S)

    def _learn(self, person: _Learnt, seen: Array, t_ns: int) -> None:
        """Both sides' lengths (2, S), NaN where not known, count alike; one wild pose does not count for more than others."""
        new_s = min(t_ns - person.t_ns, _LONGEST_NS) * 1e-9
        person.t_ns = t_ns
        sides = np.isfinite(seen).sum(axis=0)
        longer = np.nansum(seen, axis=0) / np.maximum(sides, 1) - self.table.usual
        away = np.where(sides > 0, np.clip(longer - person.longer, -MOST_LONGER_M, MOST_LONGER_M), 0.0)
        learnt_s = new_s * sides / len(seen)
        person.seconds = np.minimum(person.seconds + learnt_s, _MEMORY_S)
        person.longer = person.longer + away * learnt_s / (self._usual_s + person.seconds)


def _well_known(pose: Pose3D) -> Array:
    """(N, K, 3); NaN where a keypoint was not measured or is too uncertain."""
    variance = np.trace(pose.cov_world, axis1=-2, axis2=-1) / 3
    good = (pose.kind == Kind.FUSED) & (variance < _SURE_M**2)
    return np.where(good[..., None], pose.xyz_world, np.nan)
