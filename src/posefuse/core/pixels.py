"""The image of a frame: RGB, or converted to it when that is first asked for."""

from __future__ import annotations

from .arrays import Array


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

    def sample(self, step: int) -> Array:
        """(ceil(H / step), ceil(W / step), 3) uint8 RGB, about: every so many pixels in both directions; a copy.

        `step` is even. Turned images may be sampled before they are turned.
        """
        return self.rgb()[::step, ::step].copy()

    def fingerprint(self, step: int) -> bytes:
        """The same for the same image: of pixels sampled as by `sample` hardly more than their brightness."""
        return self.rgb()[::step, ::step, 1].tobytes()
