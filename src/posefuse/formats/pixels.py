"""Decoded frames as RGB images, converted in the thread that asks.

A frame that converts itself (`to_ndarray`) sets up FFmpeg's scaler each time, with a thread per core. For images
of 640 x 480 px that takes four times as much processor time as the conversion (`bench/live_cost.py`).
"""

from __future__ import annotations

import numpy as np
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter

from posefuse.core.arrays import Array


class PixelConverter:
    """Converts the frames of one video. Not for use from several threads at once; make one for each."""

    def __init__(self) -> None:
        self._scaler = VideoReformatter()

    def rgb(self, decoded: VideoFrame) -> Array:
        """(H, W, 3) uint8 RGB."""
        return np.asarray(self._scaler.reformat(decoded, format="rgb24", threads=1).to_ndarray())
