"""Colours of people's clothes over the cameras that see them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posefuse.core import Detections2D
from posefuse.core.arrays import Array
from posefuse.core.values import UNSEEN

from .assignment import Assignment

# numbers that describe the clothes of a person: L*, a* and b* of trunk, thighs and shanks
CLOTHING_TRAITS = 9
# one view may show another person's clothes, in front of the person
_LEAST_VIEWS = 2


def clothing_traits(assignment: Assignment, detections: Sequence[Detections2D]) -> Array:
    """(N, 9) colours of each person of the assignment, see `median_clothing`."""
    seen = np.full((*assignment.place.shape, 3, 3), np.nan)
    for row, c in np.argwhere(assignment.place != UNSEEN):
        seen[row, c] = detections[c].clothing_lab[assignment.place[row, c]]
    return np.array([median_clothing(one) for one in seen]).reshape(-1, CLOTHING_TRAITS)


def median_clothing(clothing_lab: Array) -> Array:
    """(9,) medians over views (V, 3, 3) of L*, a*, b* of trunk, thighs and shanks; NaN where fewer than two views know."""
    known = np.asarray(np.isfinite(clothing_lab).all(axis=-1))
    enough = known.sum(axis=0) >= _LEAST_VIEWS
    median = np.full((3, 3), np.nan)
    for part in np.flatnonzero(enough):
        median[part] = np.median(clothing_lab[known[:, part], part], axis=0)
    return median.ravel()
