"""Decoded frames as RGB images, converted in the thread that asks, and only when it asks.

A frame that converts itself (`to_ndarray`) sets up FFmpeg's scaler each time, with a thread per core. For images
of 640 x 480 px that takes four times as much processor time as the conversion.
"""

from __future__ import annotations

from threading import Lock
from typing import Any

import numpy as np
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter

from posefuse.core.arrays import Array
from posefuse.core.frames import Pixels

# planes of brightness and two colour differences; those with a J are of full range
_PLANAR = ("yuv420p", "yuv422p", "yuv444p", "yuvj420p", "yuvj422p", "yuvj444p")
_FULL_RANGE = 2


def _rgb_from_differences(black: float, most: float, most_difference: float) -> Array:
    """(3, 4) from brightness and two colour differences of 8 bits to RGB, by ITU-R BT.601, for `cv2.transform`."""
    matrix = np.array([[1.0, 0.0, 1.402], [1.0, -0.344136, -0.714136], [1.0, 1.772, 0.0]])
    matrix *= [255 / (most - black), 255 / most_difference, 255 / most_difference]
    return np.column_stack([matrix, -matrix @ [black, 128.0, 128.0]])


_FROM_FULL, _FROM_LIMITED = _rgb_from_differences(0.0, 255.0, 255.0), _rgb_from_differences(16.0, 235.0, 224.0)


class PixelConverter:
    """Converts the frames of one video."""

    def __init__(self) -> None:
        self._scaler, self._lock = VideoReformatter(), Lock()

    def rgb(self, decoded: VideoFrame) -> Array:
        """(H, W, 3) uint8 RGB."""
        with self._lock:
            return np.asarray(self._scaler.reformat(decoded, format="rgb24", threads=1).to_ndarray())


class DecodedPixels(Pixels):
    """A decoded frame, turned upright as its file asks."""

    def __init__(self, decoded: VideoFrame, converter: PixelConverter) -> None:
        self._decoded, self._converter = decoded, converter
        self._rgb: Array | None = None

    @property
    def size_wh(self) -> tuple[int, int]:
        """See `Pixels`."""
        width, height = self._decoded.width, self._decoded.height
        return (height, width) if round(self._decoded.rotation / 90) % 2 else (width, height)

    def rgb(self) -> Array:
        """See `Pixels`."""
        if self._rgb is None:
            self._rgb = upright(self._converter.rgb(self._decoded), self._decoded)
        return self._rgb

    def sample(self, step: int) -> Array:
        """See `Pixels`; of the usual formats only the sampled pixels are converted."""
        import cv2

        decoded = self._decoded
        name = decoded.format.name
        if name not in _PLANAR:
            return super().sample(step)
        height, width = -(-decoded.height // step), -(-decoded.width // step)
        sampled = np.empty((height, width, 3), np.uint8)
        for k, plane in enumerate(decoded.planes):
            # planes of colour differences may have half as many pixels
            down, across = step * plane.height // decoded.height, step * plane.width // decoded.width
            sampled[..., k] = _sampled(plane, down, across)[:height, :width]
        full = name.startswith("yuvj") or int(decoded.color_range) == _FULL_RANGE
        return np.asarray(cv2.transform(sampled, _FROM_FULL if full else _FROM_LIMITED))

    def fingerprint(self, step: int) -> bytes:
        """See `Pixels`."""
        if self._decoded.format.name not in _PLANAR:
            return super().fingerprint(step)
        return _sampled(self._decoded.planes[0], step, step).tobytes()


def _sampled(plane: Any, down: int, across: int) -> Array:
    """Of a plane every so many pixels; its lines may be longer than the image is wide."""
    line = plane.line_size
    return np.ndarray((plane.height, line), np.uint8, plane)[::down, : plane.width : across]


def upright(image: Array, decoded: VideoFrame) -> Array:
    """The image (H, W, 3) turned by the file's display rotation."""
    turns = round(decoded.rotation / 90) % 4
    return np.ascontiguousarray(np.rot90(image, turns)) if turns else image
