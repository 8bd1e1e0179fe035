"""Where people are in a whole image, for networks that look at one person at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from posefuse.core import Frame, Region
from posefuse.core.arrays import Array
from posefuse.detection.blazepose.persons import PersonNetwork, regions_from_outputs
from posefuse.detection.blazepose.search import stages
from posefuse.detection.regions import img_from_input, square_crop

from .crops import letterbox_from_img, region_of_box, warp_to_input
from .layouts import people_from_outputs
from .runtime import OnnxNetwork

# a camera tilted less than this is looked at as it is
_UPRIGHT_RAD = np.deg2rad(15.0)


class PersonFinder(Protocol):
    """Finds people in whole images."""

    def stages(self, frame: Frame, up_rad: float) -> Iterator[list[Region]]:
        """Regions that may hold a person, best first, stage by stage until one is confirmed."""
        ...


class BoxFinder:
    """A person detector of a card: the whole image at once, and upright where the camera is tilted.

    Args:
        network: of layout yolox or detections.
        size_wh, padding: of the keypoint network that the regions are for.
    """

    def __init__(self, network: OnnxNetwork, size_wh: tuple[int, int], padding: float) -> None:
        self._network, self._size_wh, self._padding = network, size_wh, padding

    def stages(self, frame: Frame, up_rad: float) -> Iterator[list[Region]]:
        """See `PersonFinder`."""
        for angle in upright_first(up_rad):
            takes = self._network.card.input
            affine = letterbox_from_img(frame.size_wh, takes, angle)
            (outputs,) = self._network([warp_to_input(frame.image, affine, takes, takes.fill)])
            yield [self._region(affine, box, angle) for box in people_from_outputs(self._network.card, outputs).box]

    def _region(self, input_from_img: Array, box: Array, up_rad: float) -> Region:
        made = region_of_box(box, self._size_wh, self._padding)
        ratio = float(np.sqrt(np.linalg.det(input_from_img[:, :2])))
        return Region(centre_img=img_from_input(input_from_img, made.centre_img), side_px=made.side_px / ratio, angle_rad=up_rad)


class SquareFinder:
    """The person detector that comes with BlazePose: squares of the image, ever closer."""

    def __init__(self, network: PersonNetwork) -> None:
        self._persons = network

    def stages(self, frame: Frame, up_rad: float) -> Iterator[list[Region]]:
        """See `PersonFinder`."""
        side = self._persons.network.side_px
        for squares in stages(frame.size_wh, up_rad):
            boxes, logits = self._persons.network([square_crop(frame.image, square, side) for square in squares])
            found = [
                scored
                for square, box, logit in zip(squares, boxes, logits, strict=True)
                for scored in regions_from_outputs(box, logit, self._persons.decoding, square, side)
            ]
            yield [region for _, region in sorted(found, key=lambda entry: -entry[0])]


def upright_first(up_rad: float) -> Sequence[float]:
    """Directions of up to try: that of gravity, and the image's own where that is another one."""
    return (0.0,) if abs(up_rad) < _UPRIGHT_RAD else (up_rad, 0.0)
