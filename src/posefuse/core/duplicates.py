"""One body that a detector reports several times in one view."""

from __future__ import annotations

import numpy as np

from .arrays import Array
from .values import Detections2D, keypoint_boxes

# keypoints that two detections must share before their distance is meaningful
_LEAST_SHARED = 3


def duplicates(detections: Detections2D, share: float, sure: Array | None = None) -> Array:
    """(P,) bool: the detection marks the same body as a surer one of the same view.

    Two detections are one body when the median distance of their keypoints is below `share` of the longer side of the larger
    box. A body with left and right swapped is the same body, too. Of several that are equally sure the first is kept.

    Args:
        sure: (P,) how sure each is; None: the sum of its scores.
    """
    count = len(detections)
    repeated = np.zeros(count, bool)
    if count < 2:
        return repeated
    seen = (detections.score > 0) & np.isfinite(detections.xy_img).all(axis=-1)
    xy = np.where(seen[..., None], detections.xy_img, np.nan).astype(np.float64)
    box = keypoint_boxes(xy, detections.score)
    side = np.nan_to_num(box[:, 2:] - box[:, :2]).max(axis=-1)
    close = bodies_apart(xy, xy, detections.skeleton.mirror) < share * np.maximum(side[:, None], side)
    sure = np.where(seen, detections.score, 0.0).sum(axis=1) if sure is None else sure
    kept: list[int] = []
    for p in np.argsort(-sure, kind="stable").tolist():
        if close[p, kept].any():
            repeated[p] = True
        else:
            kept.append(p)
    return repeated


def bodies_apart(one: Array, other: Array, mirror: Array) -> Array:
    """(P, Q) median distance of the keypoints of bodies (P, K, 2) and (Q, K, 2) in px; inf where they share too few.

    A body with left and right swapped is the same body: the smaller distance, of the names as they are and swapped, counts.
    """
    return np.minimum(_median_distances(one, other), _median_distances(one, other[:, mirror]))


def _median_distances(one: Array, other: Array) -> Array:
    """(P, Q) over the keypoints that both have; inf where they share too few."""
    away = other[None] - one[:, None]
    apart = np.sqrt(away[..., 0] ** 2 + away[..., 1] ** 2)
    known = np.isfinite(apart)
    shared = known.sum(axis=-1)
    ordered = np.sort(np.where(known, apart, np.inf), axis=-1)
    middle = np.take_along_axis(ordered, np.maximum(shared - 1, 0)[..., None] // 2, axis=-1)[..., 0]
    return np.where(shared >= _LEAST_SHARED, middle, np.inf)
