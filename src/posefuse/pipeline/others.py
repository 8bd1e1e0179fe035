"""People who were seen but not asked for: how many, and in which cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from posefuse.association import AssociateSettings
from posefuse.core import Detections2D, LookKind, Observations
from posefuse.core.depth import joined_depth
from posefuse.core.duplicates import duplicates
from posefuse.core.observations import NOT_KEPT
from posefuse.core.values import DETECTION_ARRAYS

# a person seen by one camera alone may be a poster on the wall
_LEAST_CAMERAS = 2


def others_seen(observations: Observations, settings: AssociateSettings) -> dict[str, int]:
    """By camera, the most people that one search of a whole image found besides those of the result; none: left out."""
    most: dict[str, int] = {}
    places = observations.frame_step.astype(np.int64) * len(observations.camera_names) + observations.frame_camera
    order = np.argsort(places, kind="stable")
    for frame in np.flatnonzero(observations.frame_look == LookKind.SEARCH).tolist():
        found = observations.detections(frame)
        begin, end = (np.searchsorted(places, places[frame], side, sorter=order) for side in ("left", "right"))
        kept = _kept(observations, order[begin:end].tolist())
        together = _joined(kept, found)
        alone = ~duplicates(together, settings.duplicate_share)[len(kept) :] & (found.score > 0).any(axis=1)
        most[found.camera] = max(most.get(found.camera, 0), int(alone.sum()))
    return {camera: count for camera, count in most.items() if count}


def others_line(seen: dict[str, int], followed: int) -> str | None:
    """One line about them; None where there is nothing to report."""
    if len(seen) < _LEAST_CAMERAS:
        return None
    where = ", ".join(f"{camera} ({count})" for camera, count in seen.items())
    count = max(seen.values())
    more = "1 more person was" if count == 1 else f"up to {count} more people were"
    return f"{more} seen than the {followed} followed: {where}; `people=N` follows more"


def _kept(observations: Observations, frames: Sequence[int]) -> Detections2D:
    """The detections of the result in these looks at one frame; surer than any other, so that they count first."""
    rows = np.concatenate([np.arange(observations.frame_begin[i], observations.frame_begin[i + 1]) for i in frames])
    rows = rows[observations.person_id[rows] != NOT_KEPT]
    one = observations.detections(frames[0])
    arrays: dict[str, Any] = observations.rows(rows)
    kept = replace(one, **arrays)
    return replace(kept, score=np.where(kept.score > 0, 1.0, 0.0))


def _joined(one: Detections2D, other: Detections2D) -> Detections2D:
    arrays: dict[str, Any] = {name: np.concatenate([getattr(one, name), getattr(other, name)]) for name in DETECTION_ARRAYS}
    return replace(other, depth_m=joined_depth([one, other]), **arrays)
