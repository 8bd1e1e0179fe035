"""Small images of the cameras, for viewers."""

from __future__ import annotations

from typing import Any

import numpy as np

from posefuse.core import Frame, LivePreview

_LONGER_SIDE_PX = 320
_QUALITY = 70


def preview(frame: Frame, t_ns: int) -> LivePreview:
    """The frame as a small JPEG."""
    import cv2

    factor = min(1.0, _LONGER_SIDE_PX / max(frame.size_wh))
    size = (max(1, round(frame.size_wh[0] * factor)), max(1, round(frame.size_wh[1] * factor)))
    small: Any = cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return LivePreview(camera=frame.camera, t_ns=t_ns, jpeg=np.asarray(jpeg).tobytes(), size_wh=size)
