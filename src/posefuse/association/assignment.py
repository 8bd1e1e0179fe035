"""The result of association: which detection of each camera is which person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.core import Detections2D, Views
from posefuse.core.arrays import Array, check_fields, freeze_fields
from posefuse.core.observations import NOT_KEPT

UNSEEN = -1


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
        people, cameras, skeleton = len(self.person_id), len(detections), detections[0].skeleton
        xy = np.full((people, cameras, len(skeleton), 2), np.nan)
        score, sigma = np.zeros(xy.shape[:-1]), np.full(xy.shape[:-1], np.nan)
        depth = None if all(seen.depth_m is None for seen in detections) else np.full(xy.shape, np.nan)
        for row, c in np.argwhere(self.place != UNSEEN):
            seen, place = detections[c], self.place[row, c]
            xy[row, c], score[row, c], sigma[row, c] = seen.xy_img[place], seen.score[place], seen.sigma_px[place]
            if depth is not None and seen.depth_m is not None:
                depth[row, c] = seen.depth_m[place]
        return Views(
            t_ns=t_ns,
            skeleton=skeleton,
            camera_names=tuple(seen.camera for seen in detections),
            person_id=self.person_id,
            xy_img=xy,
            score=score,
            sigma_px=sigma,
            depth_m=depth,
        )

    def people_of(self, c: int, count: int) -> Array:
        """(P,) the person of each of the `count` detections of camera c; -1 for those that belong to no person."""
        people = np.full(count, NOT_KEPT, np.int64)
        seen = self.place[:, c] != UNSEEN
        people[self.place[seen, c]] = self.person_id[seen]
        return people
