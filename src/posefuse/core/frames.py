"""One frame of a camera: an image that is converted to RGB when it is first asked for, and as the camera encoded it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .arrays import Array
from .depth import DepthImage
from .errors import ShapeError

# of red, green and blue, by ITU-R BT.601
_BRIGHTNESS = np.array([0.299, 0.587, 0.114])


class Pixels:
    """An image (H, W, 3) uint8 RGB; that of a subclass may not have been converted to RGB yet."""

    def __init__(self, image: Array) -> None:
        self._image = image

    @property
    def size_wh(self) -> tuple[int, int]:
        """(width, height) in px."""
        return self._image.shape[1], self._image.shape[0]

    def rgb(self) -> Array:
        """(H, W, 3) uint8 RGB; the same array each time."""
        return self._image

    def brightness(self, step: int) -> Array:
        """(ceil(H / step), ceil(W / step)) uint8, of every so many pixels in both directions; a copy.

        Turned images may be sampled before they are turned.
        """
        return np.asarray(self.rgb()[::step, ::step] @ _BRIGHTNESS).astype(np.uint8)


@dataclass(frozen=True, eq=False, kw_only=True)
class Packet:
    """The bytes of one frame, as the stream carries them.

    Attributes:
        data: what a decoder takes. keyframe: can be decoded alone. stamp_ns: presentation time on the stream's own clock.
    """

    data: bytes
    keyframe: bool
    stamp_ns: int


@dataclass(frozen=True, eq=False, kw_only=True)
class EncodedFrame:
    """One frame in the camera's own encoding; frames come in the order of their times, packets in that of decoding.

    Attributes:
        stamp_ns: presentation time on the stream's own clock.
        packets: all that the decoder was given since the frame before; the frame's own is among these or earlier ones.
        number: how many packets the stream had before these: where some are missing, the next ones cannot be decoded.
        reorder_depth: most packets that precede another one and are shown after it; 0 where the orders are the same.
        header: an .mp4 without frames that has the stream's parameters.
    """

    stamp_ns: int
    packets: tuple[Packet, ...]
    number: int
    reorder_depth: int
    header: bytes


class _Image:
    """The field `Frame.image`: set to an image or to `Pixels`, it gives the image, converted when it is first asked for."""

    def __get__(self, frame: Frame | None, owner: type[Frame]) -> Array:
        if frame is None:
            # a field without a default
            raise AttributeError
        return frame.pixels.rgb()

    def __set__(self, frame: Frame, image: Array | Pixels) -> None:
        if not isinstance(image, Pixels):
            if not isinstance(image, np.ndarray) or image.shape[2:] != (3,) or image.dtype != np.uint8:
                got = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
                raise ShapeError(f"Frame of {frame.camera}: expected an RGB uint8 image (H, W, 3), got {got}")
            image = Pixels(image)
        vars(frame)["image"] = image


@dataclass(frozen=True, eq=False, kw_only=True)
class Frame:
    """One image of one camera.

    Attributes:
        camera: its name.
        seq: counts what the camera delivered, gaps included.
        t_ns: mid-exposure on the session clock.
        received_ns: when it reached this process, same clock.
        image: (H, W, 3) uint8 RGB; not copied, so do not write to it. Given as `Pixels`, it is converted when it is first read.
        encoded: as the camera delivered it, where that is asked for and it encodes itself.
        depth: of every pixel of the image; None from a camera without depth.
    """

    camera: str
    seq: int
    t_ns: int
    received_ns: int
    image: _Image = _Image()
    encoded: EncodedFrame | None = None
    depth: DepthImage | None = None

    def __post_init__(self) -> None:
        size_hw = self.size_wh[::-1]
        if self.depth is not None and self.depth.values.shape != size_hw:
            raise ShapeError(
                f"Frame of {self.camera}: expected depth of the image's size {size_hw}, got {self.depth.values.shape}"
            )

    @property
    def pixels(self) -> Pixels:
        """What `image` is converted from. `dataclasses.replace` converts it, unless it is passed ``image=frame.pixels``."""
        pixels: Pixels = vars(self)["image"]
        return pixels

    @property
    def size_wh(self) -> tuple[int, int]:
        """(width, height) in px."""
        return self.pixels.size_wh

    def converted(self) -> Frame:
        """With its image as RGB, and without what that is made from."""
        return replace(self, image=self.image)
