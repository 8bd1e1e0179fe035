"""People who were seen but not asked for: how many, and in which cameras."""

from __future__ import annotations

from collections import Counter

import numpy as np

from posefuse.association import AssociateSettings
from posefuse.core import LookKind, Observations
from posefuse.core.duplicates import duplicates
from posefuse.core.observations import NOT_KEPT

# a person seen by one camera alone may be a poster on the wall
_LEAST_CAMERAS = 2


def others_seen(observations: Observations, settings: AssociateSettings) -> dict[str, int]:
    """By camera, the most people that one search of a whole image found besides those of the result; none: left out."""
    most: dict[str, int] = {}
    frame = observations.detection_frame[observations.person_id != NOT_KEPT]
    kept = Counter(zip(observations.frame_step[frame].tolist(), observations.frame_camera[frame].tolist(), strict=True))
    for i in np.flatnonzero(observations.frame_look == LookKind.SEARCH).tolist():
        found = observations.detections(i)
        bodies = ~duplicates(found, settings.duplicate_share) & (found.score > 0).any(axis=1)
        more = int(bodies.sum()) - kept[int(observations.frame_step[i]), int(observations.frame_camera[i])]
        if more > 0:
            most[found.camera] = max(most.get(found.camera, 0), more)
    return most


def others_line(seen: dict[str, int], followed: int) -> str | None:
    """One line about them; None where there is nothing to report."""
    if len(seen) < _LEAST_CAMERAS:
        return None
    where = ", ".join(f"{camera} ({count})" for camera, count in seen.items())
    count = max(seen.values())
    more = "1 more person was" if count == 1 else f"up to {count} more people were"
    return f"{more} seen than the {followed} followed: {where}; `people=N` follows more"
