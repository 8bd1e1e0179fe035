"""Which outputs a layout has, with which shapes, and how they are read. A card that does not match is refused in one line."""

from __future__ import annotations

from collections.abc import Sequence

from posefuse.core import ModelError
from posefuse.core.arrays import Array

from .boxes import cell_count, people_from_detections, people_from_yolox
from .card import NetworkCard
from .heatmaps import keypoints_from_heatmaps
from .keypoints import Keypoints, People
from .one_stage import people_from_rtmo, people_from_yolo_pose
from .simcc import keypoints_from_simcc

# per output of a layout, a shape whose letters may be any number
Shape = tuple[int | str, ...]
_LEAST_YOLOX_VALUES = 6


def expected_shapes(card: NetworkCard) -> list[Shape]:
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
    if card.kind == "yolox":
        return [(1, cell_count(card.input.size_wh), "5 + classes")]
    return [(1, "n", 5), (1, "n")]


def check_outputs(card: NetworkCard, names: Sequence[str], outputs: Sequence[Array]) -> None:
    """Raise ModelError, with the shapes expected and got, for outputs that are not of the card's layout."""
    expected = expected_shapes(card)
    optional = 1 if card.kind == "detections" else 0
    got = [tuple(output.shape) for output in outputs]
    enough = len(expected) - optional <= len(got)
    fitting = enough and all(_fits(shape, wanted) for shape, wanted in zip(got, expected, strict=False))
    if card.kind == "yolox" and fitting:
        fitting = got[0][2] >= _LEAST_YOLOX_VALUES + card.decoding.person_class
    if not fitting:
        have = ", ".join(f"{name} {shape}" for name, shape in zip(names, got, strict=True))
        wanted = ", ".join(_text(shape) for shape in expected)
        raise ModelError(f"model card {card.name}: {card.path.name}: expected outputs of layout {card.kind} {wanted}; got {have}")


def keypoints_of(card: NetworkCard, outputs: Sequence[Array]) -> Keypoints:
    """Keypoints (1, K) of a top-down network's outputs for one crop."""
    if card.kind == "simcc":
        return keypoints_from_simcc(outputs[0], outputs[1], card.decoding)
    return keypoints_from_heatmaps(outputs[0], card.input.size_wh, card.decoding)


def people_from_outputs(card: NetworkCard, outputs: Sequence[Array]) -> People:
    """People in the outputs of a one-stage network or a person detector for one image."""
    if card.kind == "rtmo":
        return people_from_rtmo(outputs[0], outputs[1], card.decoding)
    if card.kind == "yolo_pose":
        return people_from_yolo_pose(outputs[0], card.decoding)
    if card.kind == "yolox":
        return people_from_yolox(outputs[0], card.input.size_wh, card.decoding)
    return people_from_detections(outputs[0], outputs[1] if len(outputs) > 1 else None, card.decoding)


def _fits(shape: tuple[int, ...], wanted: Shape) -> bool:
    return len(shape) == len(wanted) and all(isinstance(w, str) or got == w for got, w in zip(shape, wanted, strict=True))


def _text(shape: Shape) -> str:
    return "(" + ", ".join(str(part) for part in shape) + ")"
