"""What a user may set about association; each default exists once, here."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt, Le, MaxLen, MinLen

from posefuse.core.duplicate_share import DUPLICATE_SHARE
from posefuse.foundation.settings import settings

# metres from the origin of the world; no place of a recording is farther
_FARTHEST_M = 10_000.0
# people that can have names, and characters of each
MOST_NAMES, MOST_NAME = 64, 64
PeopleNames = Annotated[tuple[Annotated[str, MinLen(1), MaxLen(MOST_NAME)], ...], MaxLen(MOST_NAMES)]
Place = Annotated[float, Ge(-_FARTHEST_M), Le(_FARTHEST_M)]


@settings
class AssociateSettings:
    """How detections are assigned to people, across cameras and over time.

    Attributes:
        max_people: how many people to follow, the best seen ones; their ids begin with 0.
        near_xy_m: follow the people nearest to this point of the floor (world x, y in m) instead of those on whom most views
            agree.
        tolerance_m: a view agrees with a keypoint when its ray passes within this distance, measured at the body.
        min_share: share of the keypoints of a detection that must agree for the detection to belong to a person.
        speed_max_m_s: largest speed of a followed person between time steps.
        plausible_share: share of the body lengths (limbs, trunk, girdles) of a new person that must lie within the human range,
            from a child to a tall adult; below it, the views show different people. One length in four may be wrong in a single
            frame.
        duplicate_share: two detections of one view are the same body when the median distance of their keypoints is below this
            share of their box.
        lost_after_s: how long the id of a person who is out of sight is reserved.
    """

    max_people: Annotated[int, Ge(1), Le(1000)] = 1
    near_xy_m: tuple[Place, Place] | None = None
    tolerance_m: Annotated[float, Gt(0)] = 0.15
    min_share: Annotated[float, Gt(0), Le(1)] = 0.4
    speed_max_m_s: Annotated[float, Gt(0)] = 4.0
    plausible_share: Annotated[float, Ge(0), Le(1)] = 0.7
    duplicate_share: Annotated[float, Ge(0), Le(1)] = DUPLICATE_SHARE
    lost_after_s: Annotated[float, Ge(0)] = 1.0
