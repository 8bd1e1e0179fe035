"""What a page is made of: frozen blocks in reading order."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.foundation.summary import Block

_JPEG_QUALITY = 85
_MEDIA = {b"\xff\xd8": "jpeg", b"\x89P": "png"}


@dataclass(frozen=True)
class Page:
    """A whole page; every heading of level 2 begins a new section.

    Attributes:
        title: shown on top and in the browser's tab. blocks: in reading order. subtitle: a line under the title.
    """

    title: str
    blocks: Sequence[Block]
    _: KW_ONLY
    subtitle: str = ""


@dataclass(frozen=True)
class Cards:
    """A few names and values side by side, the values large."""

    values: Mapping[str, str]
    kind: ClassVar[str] = "cards"


@dataclass(frozen=True, eq=False)
class Images:
    """Captions to images, stored inside the page.

    Attributes:
        images: JPEG or PNG bytes as they are, or RGB arrays (H, W, 3) uint8.
        lossless: arrays are stored as PNG in place of JPEG. raster: each fills the width of the page, its pixels as blocks.
    """

    images: Mapping[str, Array | bytes]
    _: KW_ONLY
    lossless: bool = False
    raster: bool = False
    kind: ClassVar[str] = "images"

    @property
    def shown(self) -> list[tuple[str, str]]:
        """Captions and ``data:`` addresses."""
        return [(caption, _data_address(image, self.lossless)) for caption, image in self.images.items()]


@dataclass(frozen=True)
class Details:
    """Blocks folded away under a line that opens them; no headings inside."""

    summary: str
    blocks: Sequence[Block]
    kind: ClassVar[str] = "details"


def _data_address(image: Array | bytes, lossless: bool) -> str:
    data = image if isinstance(image, bytes) else _encoded(image, lossless)
    media = _MEDIA.get(data[:2])
    if media is None:
        raise InputError(f"page: expected images as JPEG, PNG or RGB arrays, got {len(data)} bytes that begin with {data[:4]!r}")
    return f"data:image/{media};base64,{base64.b64encode(data).decode()}"


def _encoded(image: Array, lossless: bool) -> bytes:
    import cv2

    if image.ndim != 3 or image.shape[2] != 3 or not image.size or image.dtype != np.uint8:
        raise InputError(f"page: expected an RGB image (H, W, 3) uint8, got {image.shape} {image.dtype}")
    ending, options = (".png", []) if lossless else (".jpg", [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    done, data = cv2.imencode(ending, np.ascontiguousarray(image[..., ::-1]), options)
    if not done:
        raise InputError(f"page: an image of shape {image.shape} could not be encoded as {ending[1:].upper()}")
    return data.tobytes()
