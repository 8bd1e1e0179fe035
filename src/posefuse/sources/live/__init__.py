"""Cameras that deliver when they do: USB, network streams, and films played at the pace of the clock."""

from .paced import PacedVideoConfig, PacedVideoSource
from .stream import StreamConfig, StreamSource

__all__ = ["PacedVideoConfig", "PacedVideoSource", "StreamConfig", "StreamSource"]
