"""Networks that give people and their keypoints from the whole image at once: RTMO, and detection heads of YOLO-pose layout."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array

from .boxes import kept_indices
from .card import Decoding
from .keypoints import Keypoints, People

_BOX_AND_SCORE, _BOX_SCORE_CLASS = 5, 6


def people_from_rtmo(detections: Array, keypoints: Array, decoding: Decoding) -> People:
    """People of RTMO, best first.

    Args:
        detections: (1, N, 5) box corners and score, input px. keypoints: (1, N, K, 3) x, y, score.
        decoding: thresholds.
    """
    rows = detections[0].astype(np.float64)
    return _people(rows[:, :4], rows[:, 4], keypoints[0].astype(np.float64), decoding)


def people_from_yolo_pose(output: Array, decoding: Decoding) -> People:
    """People of a YOLO-pose head, best first.

    Args:
        output: (1, 5 + 3 K, A): centre, size, score and keypoints (x, y, score) in columns; or with `end_to_end`
            (1, N, 6 + 3 K): box corners, score, class and keypoints in rows.
        decoding: thresholds, and which of the two.
    """
    if decoding.end_to_end:
        rows = output[0].astype(np.float64)
        return _people(rows[:, :4], rows[:, 4], rows[:, _BOX_SCORE_CLASS:].reshape(len(rows), -1, 3), decoding)
    rows = output[0].T.astype(np.float64)
    centre, size = rows[:, :2], rows[:, 2:4]
    points = rows[:, _BOX_AND_SCORE:].reshape(len(rows), -1, 3)
    return _people(np.hstack([centre - size / 2, centre + size / 2]), rows[:, 4], points, decoding)


def _people(box: Array, score: Array, points: Array, decoding: Decoding) -> People:
    chosen = kept_indices(box, score, decoding)
    points = points[chosen]
    known = np.clip(np.nan_to_num(points[..., 2]), 0, 1)
    xy = np.where(known[..., None] > 0, points[..., :2], np.nan)
    return People(box[chosen], score[chosen], Keypoints(xy, known, np.full_like(xy, np.nan), np.zeros_like(known)))
