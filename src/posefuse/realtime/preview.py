"""Small images of the cameras, for viewers."""

from __future__ import annotations

from typing import Any

from posefuse.core import Frame, LivePreview
from posefuse.outputs.drawing import jpeg_of, shrunk_wh

_LONGER_SIDE_PX = 320
_QUALITY = 70


def preview_jpeg(frame: Frame, t_ns: int) -> LivePreview:
    """The frame as a small JPEG."""
    import cv2

    size = shrunk_wh(frame.size_wh, _LONGER_SIDE_PX)
    small: Any = cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA)
    return LivePreview(camera=frame.camera, t_ns=t_ns, jpeg=jpeg_of(small, _QUALITY), size_wh=size)
