"""Tracks of other tools' trackers, which see one camera each, as hints about which person is which."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from posefuse.core import Detections2D
from posefuse.core.arrays import Array
from posefuse.core.values import NO_TRACK, UNSEEN

from .candidates import Assignment, Candidates

# by camera and the number of another tool's track: the person
Hints = Mapping[tuple[str, int], int]
# factor on the support of a detection for the person to whom it was recently assigned
_HINT_WEIGHT = 1.3


def hints_after(hints: Hints, assignment: Assignment, detections: Sequence[Detections2D]) -> Hints:
    """Who the tracks of another tool's tracker are, after a time step: the person that they were last taken for."""
    known = dict(hints)
    for row, c in np.argwhere(assignment.place != UNSEEN):
        track = int(detections[c].track_id[assignment.place[row, c]])
        if track != NO_TRACK:
            known[detections[c].camera, track] = int(assignment.person_id[row])
    return known


def hint_weights(candidates: Candidates, detections: Sequence[Detections2D], people: Sequence[int], hints: Hints) -> Array:
    """(N, D) the support that each detection gives to each of `people`, changed by another tool's tracks."""
    factor = np.ones((len(people), len(candidates)))
    if not hints:
        return factor
    rows = {person: row for row, person in enumerate(people)}
    for d, (c, place) in enumerate(zip(candidates.camera, candidates.place, strict=True)):
        row = rows.get(hints.get((detections[c].camera, int(detections[c].track_id[place])), NO_TRACK))
        if row is not None:
            factor[row, d] = _HINT_WEIGHT
    return factor
