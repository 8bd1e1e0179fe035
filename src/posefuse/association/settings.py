"""What a user may set about association; each default exists once, here."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt, Le

from posefuse.core.duplicates import DUPLICATE_SHARE
from posefuse.foundation.settings import settings

# metres from the origin of the world; no place of a recording is farther
_FARTHEST_M = 10_000.0
Place = Annotated[float, Ge(-_FARTHEST_M), Le(_FARTHEST_M)]


@settings
class AssociateSettings:
    """Who is who, across cameras and time.

    Attributes:
        max_people: how many people to follow; their ids are 0 .. max_people - 1.
        near_xy_m: newcomers are taken by how close they stand to this place of the ground (world x, y), not by how many
            views agree on them.
        tolerance_m: how far a keypoint may lie from its ray, measured at the body, for a view to agree.
        min_share: share of a detection's keypoints that must agree for it to be this person.
        speed_max_m_s: how fast a followed person may move between instants.
        plausible_share: share of a newcomer's body lengths (limbs, trunk, girdles) that a human body can have, from a child to
            a tall adult; below it the views are of different people. One length in four may be wrong in a single frame.
        duplicate_share: two detections of one view whose keypoints are closer than this share of their box (median) are one
            body.
        lost_after_s: how long the place of a followed person who is out of sight is kept free.
    """

    max_people: Annotated[int, Ge(1), Le(1000)] = 1
    near_xy_m: tuple[Place, Place] | None = None
    tolerance_m: Annotated[float, Gt(0)] = 0.15
    min_share: Annotated[float, Gt(0), Le(1)] = 0.4
    speed_max_m_s: Annotated[float, Gt(0)] = 4.0
    plausible_share: Annotated[float, Ge(0), Le(1)] = 0.7
    duplicate_share: Annotated[float, Ge(0), Le(1)] = DUPLICATE_SHARE
    lost_after_s: Annotated[float, Ge(0)] = 1.0
