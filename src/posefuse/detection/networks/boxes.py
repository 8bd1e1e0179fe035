"""Boxes of people: outputs of person detectors, and the best one of those that overlap."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array
from posefuse.detection.regions import overlap

from .card import Decoding
from .keypoints import People

_STRIDES = (8, 16, 32)


def people_from_yolox(output: Array, size_wh: tuple[int, int], decoding: Decoding) -> People:
    """People of a YOLOX head, best first.

    Args:
        output: (1, A, 5 + classes): centre x, y, width, height, objectness and class probabilities of each cell of grids of
            stride 8, 16 and 32, row by row; with `raw_boxes` the first four as offsets from the cell and logarithms, in strides.
        size_wh: px of the input.
        decoding: thresholds, and which class is a person.
    """
    rows = output[0].astype(np.float64)
    centre, size = rows[:, :2], rows[:, 2:4]
    if decoding.raw_boxes:
        cells, strides = _grid(size_wh)
        centre, size = (centre + cells) * strides, np.exp(np.minimum(size, 20.0)) * strides
    score = rows[:, 4] * rows[:, 5 + decoding.person_class]
    return kept(People(np.hstack([centre - size / 2, centre + size / 2]), score), decoding)


def people_from_detections(detections: Array, labels: Array | None, decoding: Decoding) -> People:
    """People of a detector whose file ends with its own selection (RTMDet, YOLOX by MMDeploy), best first.

    Args:
        detections: (1, N, 5) box corners and score. labels: (1, N) classes; None: all are people.
        decoding: thresholds, and which class is a person.
    """
    rows = detections[0].astype(np.float64)
    person = np.full(len(rows), True) if labels is None else labels[0] == decoding.person_class
    return kept(People(rows[person, :4], rows[person, 4]), decoding)


def kept_indices(box: Array, score: Array, decoding: Decoding) -> Array:
    """Indices of the boxes that score enough and overlap no better one too much, best first."""
    left = np.flatnonzero(score >= decoding.least_score)
    left = left[np.argsort(-score[left], kind="stable")]
    chosen = []
    while len(left):
        chosen.append(left[0])
        left = left[1:][overlap(box[left[0]], box[left[1:]]) <= decoding.most_overlap]
    return np.array(chosen, dtype=np.intp)


def kept(people: People, decoding: Decoding) -> People:
    """The same without those of `kept_indices` that are left out; boxes only."""
    chosen = kept_indices(people.box, people.score, decoding)
    return People(people.box[chosen], people.score[chosen])


def cell_count(size_wh: tuple[int, int]) -> int:
    """How many cells the grids of a YOLOX head have for this input."""
    return sum((size_wh[0] // stride) * (size_wh[1] // stride) for stride in _STRIDES)


def _grid(size_wh: tuple[int, int]) -> tuple[Array, Array]:
    """Column and row (A, 2) of each cell in its grid, and its stride (A, 1)."""
    cells, strides = [], []
    for stride in _STRIDES:
        x, y = np.meshgrid(np.arange(size_wh[0] // stride), np.arange(size_wh[1] // stride))
        cells.append(np.stack([x.ravel(), y.ravel()], axis=-1))
        strides.append(np.full((x.size, 1), stride))
    return np.concatenate(cells), np.concatenate(strides)
