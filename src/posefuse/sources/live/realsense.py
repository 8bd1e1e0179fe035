"""Colour stream of a RealSense camera, timed by the camera at mid-exposure.

The camera's clock is turned into the machine's by the maker's library ("global time"). Its stamp is when the image began to be
read out; how long before that the middle of the exposure was, the camera says in two numbers of its own clock.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from posefuse.core import Frame, SourceError

from .depth_camera import ANY, chosen, vendor_module, wanted_size
from .stream import StampClock


@dataclass(frozen=True)
class RealSenseConfig:
    """One RealSense camera.

    Attributes:
        camera: name of the camera in the rig. serial: its serial number; ``any`` takes the first that is found.
        size: ``WIDTHxHEIGHT@RATE``.
        read_s: a camera that says nothing for so long is lost.
    """

    camera: str
    serial: str = ANY
    size: str = "640x480@30"
    read_s: float = 5.0

    def build(self) -> RealSenseSource:
        """Start the stream; raises DependencyError without ``pyrealsense2``, SourceError when there is no such camera."""
        return RealSenseSource(self)


class RealSenseSource:
    """Frames of one camera in RGB; times are Unix epoch by the machine's clock, mid-exposure."""

    def __init__(self, config: RealSenseConfig) -> None:
        self._config = config
        self._rs = vendor_module("pyrealsense2", "realsense")
        width, height, rate = wanted_size(self._where, config.size)
        self._size_wh = width, height
        devices = self._rs.context().query_devices()
        serial = chosen(self._where, config.serial, [d.get_info(self._rs.camera_info.serial_number) for d in devices])
        asked = self._rs.config()
        asked.enable_device(serial)
        asked.enable_stream(self._rs.stream.color, width, height, self._rs.format.rgb8, rate)
        self._pipeline: Any = self._rs.pipeline()
        try:
            self._pipeline.start(asked)
        except RuntimeError as error:
            raise SourceError(f"{self._where}: cannot deliver {config.size} ({error})") from None
        self._running = True
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._clock, self._newest_ns = StampClock(0), 0

    @property
    def camera(self) -> str:
        """Name of the camera."""
        return self._config.camera

    @property
    def size_wh(self) -> tuple[int, int]:
        """(width, height) of every frame in px."""
        return self._size_wh

    def frames(self) -> Iterator[Frame]:
        """Frames as they come; raises SourceError when they stop coming."""
        while self._running:
            try:
                color = self._pipeline.wait_for_frames(round(1000 * self._config.read_s)).get_color_frame()
            except RuntimeError as error:
                raise SourceError(f"{self._where}: no image any more ({error})") from None
            if not color:
                continue
            arrived_ns = time.monotonic_ns() + self._epoch_ns
            self._newest_ns = max(self._newest_ns + 1, self._exposed_ns(color, arrived_ns))
            # the library uses its memory again
            image = np.array(color.get_data())
            yield Frame(self.camera, int(color.get_frame_number()), self._newest_ns, arrived_ns, image)

    def close(self) -> None:
        """Stop the stream; safe to call twice."""
        if self._running:
            self._running = False
            self._pipeline.stop()

    @property
    def _where(self) -> str:
        return f"RealSense {self._config.serial}: camera {self.camera}"

    def _exposed_ns(self, color: Any, arrived_ns: int) -> int:
        stamp_ns = round(color.get_timestamp() * 1e6)
        if color.get_frame_timestamp_domain() == self._rs.timestamp_domain.hardware_clock:
            read_ns = self._clock.placed(stamp_ns, arrived_ns)
        else:
            # the machine's clock may have been set since the start, the session's has not
            read_ns = arrived_ns - (time.time_ns() - stamp_ns)
        return read_ns - self._exposed_before_ns(color)

    def _exposed_before_ns(self, color: Any) -> int:
        known = self._rs.frame_metadata_value
        if not all(color.supports_frame_metadata(key) for key in (known.frame_timestamp, known.sensor_timestamp)):
            return 0
        before_us = color.get_frame_metadata(known.frame_timestamp) - color.get_frame_metadata(known.sensor_timestamp)
        return 1000 * max(0, int(before_us))
