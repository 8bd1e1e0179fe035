"""Cameras that deliver when they do: USB, network streams, and videos played at the pace of the clock."""

from posefuse.sources.video import PacedVideoConfig, PacedVideoSource

from .realsense import RealSenseConfig, RealSenseSource
from .stream import StreamConfig, StreamSource
