"""Boxes of people in whole images, with keypoints from one-stage networks (RTMO, YOLO-pose); and which outputs a layout has.

A card whose outputs do not match its layout is refused in one line.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posefuse.core import ModelError
from posefuse.core.arrays import Array

from .card import Decoding, OnnxCard
from .crops import overlapping_groups
from .decode import Keypoints, People, keypoints_from_heatmaps, keypoints_from_simcc


def people_from_detections(detections: Array, labels: Array | None, decoding: Decoding) -> People:
    """People of a detector whose file ends with its own selection (RTMDet, YOLOX by MMDeploy), best first.

    Args:
        detections: (1, N, 5) box corners and score. labels: (1, N) classes; None: all are people.
        decoding: thresholds, and which class is a person.
    """
    rows = detections[0].astype(np.float64)
    person = np.full(len(rows), True) if labels is None else labels[0] == decoding.person_class
    return _kept(rows[person, :4], rows[person, 4], decoding)


def _kept(box: Array, score: Array, decoding: Decoding, points: Array | None = None) -> People:
    """Boxes that score enough and overlap no better one too much, best first, with their points (N, K, 3) if there are some."""
    left = np.flatnonzero(score >= decoding.least_score)
    left = left[np.argsort(-score[left], kind="stable")]
    chosen = left[np.array([group[0] for group in overlapping_groups(box[left], decoding.most_overlap)], np.intp)]
    if points is None:
        return People(box[chosen], score[chosen])
    known = np.clip(np.nan_to_num(points[chosen, :, 2]), 0, 1)
    xy = np.where(known[..., None] > 0, points[chosen, :, :2], np.nan)
    return People(box[chosen], score[chosen], Keypoints(xy, known, np.full_like(xy, np.nan), np.zeros_like(known)))


_BOX_AND_SCORE, _BOX_SCORE_CLASS = 5, 6


def people_from_rtmo(detections: Array, keypoints: Array, decoding: Decoding) -> People:
    """People of RTMO, best first.

    Args:
        detections: (1, N, 5) box corners and score, input px. keypoints: (1, N, K, 3) x, y, score.
        decoding: thresholds.
    """
    rows = detections[0].astype(np.float64)
    return _kept(rows[:, :4], rows[:, 4], decoding, keypoints[0].astype(np.float64))


def people_from_yolo_pose(output: Array, decoding: Decoding) -> People:
    """People of a YOLO-pose head, best first.

    Args:
        output: (1, 5 + 3 K, A): centre, size, score and keypoints (x, y, score) in columns; or with `end_to_end`
            (1, N, 6 + 3 K): box corners, score, class and keypoints in rows.
        decoding: thresholds, and which of the two.
    """
    if decoding.end_to_end:
        rows = output[0].astype(np.float64)
        return _kept(rows[:, :4], rows[:, 4], decoding, rows[:, _BOX_SCORE_CLASS:].reshape(len(rows), -1, 3))
    rows = output[0].T.astype(np.float64)
    centre, size = rows[:, :2], rows[:, 2:4]
    points = rows[:, _BOX_AND_SCORE:].reshape(len(rows), -1, 3)
    return _kept(np.hstack([centre - size / 2, centre + size / 2]), rows[:, 4], decoding, points)


# per output of a layout, a shape whose letters may be any number
Shape = tuple[int | str, ...]


def expected_shapes(card: OnnxCard) -> list[Shape]:
    """Shapes of the outputs that the card's layout has, for one image."""
    width, height = card.input.size_wh
    count = len(card.skeleton) if card.keypoints else 0
    ratio = card.decoding.split_ratio
    if card.kind == "simcc":
        return [(1, count, round(width * ratio)), (1, count, round(height * ratio))]
    if card.kind == "heatmap":
        return [(1, count, "h", "w")]
    if card.kind == "rtmo":
        return [(1, "n", 5), (1, "n", count, 3)]
    if card.kind == "yolo_pose":
        return [(1, "n", 6 + 3 * count) if card.decoding.end_to_end else (1, 5 + 3 * count, "n")]
    return [(1, "n", 5), (1, "n")]


def check_outputs(card: OnnxCard, names: Sequence[str], outputs: Sequence[Array]) -> None:
    """Raise ModelError, with the shapes expected and got, for outputs that are not of the card's layout."""
    expected = expected_shapes(card)
    optional = 1 if card.kind == "detections" else 0
    got = [tuple(output.shape) for output in outputs]
    enough = len(expected) - optional <= len(got)
    fitting = enough and all(_fits(shape, wanted) for shape, wanted in zip(got, expected, strict=False))
    if not fitting:
        have = ", ".join(f"{name} {shape}" for name, shape in zip(names, got, strict=True))
        wanted = ", ".join(_text(shape) for shape in expected)
        raise ModelError(f"model card {card.name}: {card.file_name}: expected outputs of layout {card.kind} {wanted}; got {have}")


def keypoints_of(card: OnnxCard, outputs: Sequence[Array]) -> Keypoints:
    """Keypoints (B, K) of a top-down network's outputs (B, ...) for B crops."""
    if card.kind == "simcc":
        return keypoints_from_simcc(outputs[0], outputs[1], card.decoding)
    return keypoints_from_heatmaps(outputs[0], card.input.size_wh, card.decoding)


def people_from_outputs(card: OnnxCard, outputs: Sequence[Array]) -> People:
    """People in the outputs of a one-stage network or a person detector for one image."""
    if card.kind == "rtmo":
        return people_from_rtmo(outputs[0], outputs[1], card.decoding)
    if card.kind == "yolo_pose":
        return people_from_yolo_pose(outputs[0], card.decoding)
    return people_from_detections(outputs[0], outputs[1] if len(outputs) > 1 else None, card.decoding)


def _fits(shape: tuple[int, ...], wanted: Shape) -> bool:
    return len(shape) == len(wanted) and all(isinstance(w, str) or got == w for got, w in zip(shape, wanted, strict=True))


def _text(shape: Shape) -> str:
    return "(" + ", ".join(str(part) for part in shape) + ")"
