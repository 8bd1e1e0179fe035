"""Where to look for people in a whole image: as it is, then upright, then closer."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posefuse.core import Region

# a camera tilted less than this needs no view of its own
_UPRIGHT_RAD = np.deg2rad(15.0)
_ZOOMS = (1.6, 2.5)
_OVERLAP = 0.4


def stages(size_wh: tuple[int, int], up_rad: float) -> Iterator[list[Region]]:
    """Squares of the image to look at together, stage by stage until a stage finds no new person.

    Args:
        size_wh: of the image.
        up_rad: where gravity's up is in the image, clockwise from the image's up; 0 when unknown.

    Yields:
        The whole image as it is; turned upright by gravity; and tiles of it, ever smaller.
    """
    yield [_whole(size_wh, 0.0)]
    if abs(up_rad) > _UPRIGHT_RAD:
        yield [_whole(size_wh, up_rad)]
    for zoom in _ZOOMS:
        yield _tiles(size_wh, max(size_wh) / zoom, up_rad)


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
