"""Where people are in whole images, for networks that look at one person at a time: BlazePose's person network, or a card's.

Each anchor of the person network gives a box and four alignment points as offsets from the anchor's cell, in crop px, and one
logit (Bazarevsky et al. 2020, "BlazePose: On-device Real-time Body Pose tracking": the middle of the hips and a circle around the
whole person).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np

from posefuse.core import Frame, Region
from posefuse.core.arrays import Array

from .boxes import people_from_outputs
from .card import PersonCard, PersonDecoding
from .crops import Crops, img_from_crop, img_from_input, letterbox_from_img, overlapping_groups, region_of_box, warp_to_input
from .decode import People
from .device import CPU, Device, Precision
from .engines import BlazePoseNetwork, OnnxNetwork

# a camera tilted less than this needs no view of its own
_UPRIGHT_RAD = np.deg2rad(15.0)
_ZOOMS = (1.6, 2.5)
_OVERLAP = 0.4


def _whole(size_wh: tuple[int, int], angle_rad: float) -> Region:
    width, height = size_wh
    cosine, sine = abs(np.cos(angle_rad)), abs(np.sin(angle_rad))
    side = max(width * cosine + height * sine, width * sine + height * cosine)
    wrapped = float(np.arctan2(np.sin(angle_rad), np.cos(angle_rad)))
    return Region(centre_img=np.array([(width - 1) / 2, (height - 1) / 2]), side_px=float(side), angle_rad=wrapped)


def _tiles(size_wh: tuple[int, int], side_px: float, angle_rad: float) -> list[Region]:
    """Overlapping squares that cover the image, from the middle outwards."""
    lines = []
    for length in size_wh:
        room = max(length - side_px, 0.0)
        count = int(np.ceil(room / (side_px * (1 - _OVERLAP)))) + 1
        lines.append((length - 1) / 2 + np.linspace(-room / 2, room / 2, count) if count > 1 else np.array([(length - 1) / 2]))
    centres = np.stack(np.meshgrid(*lines), axis=-1).reshape(-1, 2)
    middle = (np.array(size_wh) - 1) / 2
    order = np.argsort(np.linalg.norm(centres - middle, axis=-1), kind="stable")
    return [Region(centre_img=centre, side_px=side_px, angle_rad=angle_rad) for centre in centres[order]]


# the circle is tight; the landmark network was trained on squares this much larger
_ROOM = 1.25
_SAME_PERSON_IOU = 0.3
_FIRST_POINT = 4
# of an anchor that shows a person
_LEAST_SCORE = 0.5


def regions_from_outputs(
    boxes: Array, logits: Array, decoding: PersonDecoding, looked_at: Region, side_px: int
) -> list[tuple[float, Region]]:
    """People found in one crop, best first, as (score, region in raw px).

    Args:
        boxes: (A, 4 + 2 * points) centre, size and alignment points per anchor.
        logits: (A, 1).
        decoding: how to read them.
        looked_at: the region the crop was cut from.
        side_px: of the crop.
    """
    score = 1 / (1 + np.exp(-np.clip(logits[:, 0].astype(np.float64), -100, 100)))
    likely = np.flatnonzero(score >= _LEAST_SCORE)
    likely = likely[np.argsort(-score[likely], kind="stable")]
    cells = _anchor_centres(decoding.grids, side_px)[likely]
    raw = boxes[likely].astype(np.float64)
    centre, size = raw[:, :2] + cells, raw[:, 2:4]
    points = raw[:, _FIRST_POINT:].reshape(len(likely), (raw.shape[1] - _FIRST_POINT) // 2, 2) + cells[:, None]
    found = []
    for group in overlapping_groups(np.hstack([centre - size / 2, centre + size / 2]), _SAME_PERSON_IOU):
        weight = score[likely[group]]
        merged = np.average(points[group], axis=0, weights=weight)
        # continuous crop coordinates start at the corner, pixel centres half a pixel later
        ends = img_from_crop(looked_at, side_px, merged[[decoding.centre_keypoint, decoding.rim_keypoint]] - 0.5)
        up = ends[1] - ends[0]
        radius = float(np.linalg.norm(up))
        if radius > 0:
            region = Region(centre_img=ends[0], side_px=2 * _ROOM * radius, angle_rad=float(np.arctan2(up[0], -up[1])))
            found.append((float(weight[0]), region))
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


class PersonFinder(Protocol):
    """Finds people in whole images."""

    def stages(self, size_wh: tuple[int, int], up_rad: float) -> Iterator[list[Region]]:
        """Squares of an image of this size to look at together, stage by stage until a person is confirmed.

        up_rad: where gravity's up is in the image, clockwise from the image's up; 0 when unknown.
        """
        ...

    def people(self, looks: Sequence[tuple[Frame, Sequence[Region]]]) -> list[list[Region]]:
        """For each frame the regions that may hold a person, best first, in these parts of it; all are looked at in one call."""
        ...


class BoxFinder:
    """A person detector of a card: the whole image at once, and upright where the camera is tilted.

    Args:
        network: of layout detections.
        size_wh, padding: of the keypoint network that the regions are for.
    """

    def __init__(self, network: OnnxNetwork, size_wh: tuple[int, int], padding: float) -> None:
        self._network, self._size_wh, self._padding = network, size_wh, padding

    def stages(self, size_wh: tuple[int, int], up_rad: float) -> Iterator[list[Region]]:
        """See `PersonFinder`."""
        return ([_whole(size_wh, angle)] for angle in upright_first(up_rad))

    def people(self, looks: Sequence[tuple[Frame, Sequence[Region]]]) -> list[list[Region]]:
        """See `PersonFinder`."""
        whole = [(frame, part.angle_rad) for frame, parts in looks for part in parts]
        return [
            [self._region(affine, box, angle) for box in people.box]
            for (people, affine), (_, angle) in zip(people_in_images(self._network, whole), whole, strict=True)
        ]

    def _region(self, input_from_img: Array, box: Array, up_rad: float) -> Region:
        made = region_of_box(box, self._size_wh, self._padding)
        ratio = float(np.sqrt(np.linalg.det(input_from_img[:, :2])))
        return Region(centre_img=img_from_input(input_from_img, made.centre_img), side_px=made.side_px / ratio, angle_rad=up_rad)


class SquareFinder:
    """The person detector that comes with BlazePose: squares of the image, ever closer.

    Args:
        card, file: of its network. precision, streams, device: see `BlazePoseNetwork`.
    """

    def __init__(self, card: PersonCard, file: Path, precision: Precision, streams: int, device: Device = CPU) -> None:
        outputs = (card.decoding.boxes, card.decoding.scores)
        self._network = BlazePoseNetwork(file, outputs, card.input, precision, streams, device)
        self._decoding = card.decoding

    @staticmethod
    def stages(size_wh: tuple[int, int], up_rad: float) -> Iterator[list[Region]]:
        """The whole image as it is; turned upright by gravity; and tiles of it, ever smaller. See `PersonFinder`."""
        yield [_whole(size_wh, 0.0)]
        if abs(up_rad) > _UPRIGHT_RAD:
            yield [_whole(size_wh, up_rad)]
        for zoom in _ZOOMS:
            yield _tiles(size_wh, max(size_wh) / zoom, up_rad)

    def people(self, looks: Sequence[tuple[Frame, Sequence[Region]]]) -> list[list[Region]]:
        """See `PersonFinder`."""
        side = self._network.side_px
        squares = [(frame.image, square) for frame, some in looks for square in some]
        boxes, logits = self._network(Crops(squares, side))
        scored = (
            regions_from_outputs(box, logit, self._decoding, square, side)
            for (_, square), box, logit in zip(squares, boxes, logits, strict=True)
        )
        found = [[entry for _ in squares for entry in next(scored)] for _, squares in looks]
        return [[region for _, region in sorted(one, key=lambda entry: -entry[0])] for one in found]


def people_in_images(network: OnnxNetwork, images: Sequence[tuple[Frame, float]]) -> Iterator[tuple[People, Array]]:
    """People in whole images, each turned so that this direction of up is up, and the (2, 3) affine map from raw px to theirs."""
    card, takes = network.card, network.card.input
    affines = [letterbox_from_img(frame.size_wh, takes, angle) for frame, angle in images]
    inputs = [warp_to_input(one.image, affine, takes, takes.fill) for (one, _), affine in zip(images, affines, strict=True)]
    return ((people_from_outputs(card, one), affine) for one, affine in zip(network(inputs), affines, strict=True))


def upright_first(up_rad: float) -> Sequence[float]:
    """Directions of up to try: that of gravity, and the image's own where that is another one."""
    return (0.0,) if abs(up_rad) < _UPRIGHT_RAD else (up_rad, 0.0)
