"""Where people are: outputs of the single-shot person detector to upright regions.

Each anchor gives a box and four alignment points as offsets from the anchor's cell, in crop px, and one logit (Bazarevsky et al.
2020, "BlazePose: On-device Real-time Body Pose tracking": the middle of the hips and a circle around the whole person).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from posefuse.core import ModelError, Region
from posefuse.core.arrays import Array
from posefuse.detection.models import ModelCard, PersonDecoding
from posefuse.detection.openvino_cpu import Precision
from posefuse.detection.regions import img_from_crop, overlap

from .network import BlazePoseNetwork

# the circle is tight; the landmark network was trained on squares this much larger
_ROOM = 1.25
_SAME_PERSON_IOU = 0.3
_FIRST_POINT = 4
# of an anchor that shows a person
_LEAST_SCORE = 0.5


@dataclass(frozen=True, eq=False)
class PersonNetwork:
    """A person detector and how to read it."""

    network: BlazePoseNetwork
    decoding: PersonDecoding

    @classmethod
    def compiled(cls, card: ModelCard, file: Path, precision: Precision, streams: int) -> PersonNetwork:
        """The card's network, ready; raises ModelError when the card is of another kind."""
        if not isinstance(card.decoding, PersonDecoding):
            raise ModelError(f"model card {card.name}: expected kind person_ssd, got {card.kind}")
        outputs = (card.decoding.boxes, card.decoding.scores)
        return cls(BlazePoseNetwork(file, outputs, card.input, precision, streams), card.decoding)


def regions_from_outputs(
    boxes: Array, logits: Array, decoding: PersonDecoding, looked_at: Region, side_px: int, least_score: float = _LEAST_SCORE
) -> list[tuple[float, Region]]:
    """People found in one crop, best first, as (score, region in raw px).

    Args:
        boxes: (A, 4 + 2 * points) centre, size and alignment points per anchor.
        logits: (A, 1).
        decoding: how to read them.
        looked_at: the region the crop was cut from.
        side_px: of the crop.
        least_score: below it no person is there.
    """
    score = 1 / (1 + np.exp(-np.clip(logits[:, 0].astype(np.float64), -100, 100)))
    likely = np.flatnonzero(score >= least_score)
    likely = likely[np.argsort(-score[likely], kind="stable")]
    cells = _anchor_centres(decoding.grids, side_px)[likely]
    raw = boxes[likely].astype(np.float64)
    centre, size = raw[:, :2] + cells, raw[:, 2:4]
    points = raw[:, _FIRST_POINT:].reshape(len(likely), (raw.shape[1] - _FIRST_POINT) // 2, 2) + cells[:, None]
    found = []
    for group in _groups(np.hstack([centre - size / 2, centre + size / 2])):
        weight = score[likely[group]]
        merged = np.average(points[group], axis=0, weights=weight)
        # continuous crop coordinates start at the corner, pixel centres half a pixel later
        ends = img_from_crop(looked_at, side_px, merged[[decoding.centre_keypoint, decoding.rim_keypoint]] - 0.5)
        up = ends[1] - ends[0]
        radius = float(np.linalg.norm(up))
        if radius > 0:
            found.append(
                (
                    float(weight[0]),
                    Region(centre_img=ends[0], side_px=2 * _ROOM * radius, angle_rad=float(np.arctan2(up[0], -up[1]))),
                )
            )
    return found


@lru_cache(maxsize=4)
def _anchor_centres(grids: tuple[tuple[int, int], ...], side_px: int) -> Array:
    """(A, 2) crop px, row by row of each grid."""
    parts = []
    for cells, anchors in grids:
        middle = (np.arange(cells) + 0.5) * side_px / cells
        x, y = np.meshgrid(middle, middle)
        parts.append(np.repeat(np.stack([x.ravel(), y.ravel()], axis=-1), anchors, axis=0))
    return np.concatenate(parts)


def _groups(corners: Array) -> list[Array]:
    """Indices of boxes (B, 4), best first, that overlap the best box left: one group per person."""
    left = np.arange(len(corners))
    groups = []
    while len(left):
        same = overlap(corners[left[0]], corners[left]) > _SAME_PERSON_IOU
        same[0] = True
        groups.append(left[same])
        left = left[~same]
    return groups
