"""The result of association: which detection of each camera is which person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.core import Detections2D, Views
from posefuse.core.arrays import Array, check_fields, freeze_fields
from posefuse.core.observations import NOT_KEPT
from posefuse.core.values import UNSEEN


@dataclass(frozen=True, eq=False, kw_only=True)
class Assignment:
    """Which detection of each camera is which person.

    Attributes:
        person_id: (N,) int64.
        place: (N, C) index among the detections of the camera; -1 where the camera does not see the person.
    """

    person_id: Array
    place: Array

    def __post_init__(self) -> None:
        freeze_fields(self, {"person_id": np.int64, "place": np.int64})
        check_fields(self, {"person_id": "N", "place": "N C"})

    def views(self, detections: Sequence[Detections2D], t_ns: int) -> Views:
        """The people's detections, one per camera in the order of axis C, as views at this time."""
        return Views.of(detections, t_ns, self.person_id, self.place)

    def people_of(self, c: int, count: int) -> Array:
        """(P,) the person of each of the `count` detections of camera c; -1 for those that belong to no person."""
        people = np.full(count, NOT_KEPT, np.int64)
        seen = self.place[:, c] != UNSEEN
        people[self.place[seen, c]] = self.person_id[seen]
        return people
