"""Colour streams of RealSense cameras, timed by the camera at mid-exposure, and their depth aligned with it.

They are found by serial number and asked for a size. The camera's clock is turned into the machine's by the maker's library
("global time"). Its stamp is when the image began to be read out; the time from the middle of the exposure to the readout follows
from two numbers of the camera's own clock.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from posefuse.core import Frame, SourceError
from posefuse.core.depth import MM_PER_M, DepthImage, DepthNoise
from posefuse.core.errors import choices
from posefuse.core.extras import package_of_extra

from .stream import StampClock

_ANY = "any"


@dataclass(frozen=True)
class RealSenseConfig:
    """The colour stream of one RealSense camera, and its depth.

    Attributes:
        camera: name of the camera in the rig. serial: its serial number; ``any`` takes the first that is found.
        size: ``WIDTHxHEIGHT@RATE``.
        read_s: a camera that sends nothing for so long is lost.
        depth: give every frame its depth, aligned with the colours by the maker's library.
    """

    camera: str
    serial: str = _ANY
    size: str = "640x480@30"
    read_s: float = 5.0
    depth: bool = False

    def build(self) -> RealSenseSource:
        """Start the stream; raises DependencyError without ``pyrealsense2``, SourceError when there is no such camera."""
        return RealSenseSource(self)


def _wanted_size(where: str, size: str) -> tuple[int, int, int]:
    """(width, height, rate) of ``WIDTHxHEIGHT[@RATE]``, 30 Hz where no rate is given."""
    match = re.fullmatch(r"(\d+)x(\d+)(?:@(\d+))?", size)
    if not match:
        raise SourceError(f"{where}: size: expected WIDTHxHEIGHT or WIDTHxHEIGHT@RATE, got {size!r}")
    return int(match[1]), int(match[2]), int(match[3] or 30)


def _chosen(where: str, wanted: str, there: list[str]) -> str:
    """The serial number to open; raises SourceError that lists the connected cameras."""
    if not there:
        raise SourceError(f"{where}: no such camera is connected")
    if wanted in ("", _ANY):
        return there[0]
    if wanted not in there:
        raise SourceError(f"{where}: not connected; there are: {choices(sorted(there))}")
    return wanted


class RealSenseSource:
    """Frames of one RealSense camera in RGB; times are Unix epoch by the machine's clock, mid-exposure."""

    def __init__(self, config: RealSenseConfig) -> None:
        self._config = config
        self.camera = config.camera
        self._vendor: Any = package_of_extra("pyrealsense2", "realsense")
        *size_wh, self._rate_hz = _wanted_size(self._where, config.size)
        self.size_wh = size_wh[0], size_wh[1]
        try:
            self._start(_chosen(self._where, config.serial, self._serials()))
        except RuntimeError as error:
            raise SourceError(f"{self._where}: cannot deliver {config.size} ({error})") from None
        self._running = True
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._newest_ns = 0

    def close(self) -> None:
        """Stop the stream; safe to call twice."""
        if self._running:
            self._running = False
            self._pipeline.stop()

    @property
    def _where(self) -> str:
        return f"RealSense {self._config.serial}: camera {self.camera}"

    def _serials(self) -> list[str]:
        devices = self._vendor.context().query_devices()
        return [device.get_info(self._vendor.camera_info.serial_number) for device in devices]

    def _start(self, serial: str) -> None:
        asked = self._vendor.config()
        asked.enable_device(serial)
        asked.enable_stream(self._vendor.stream.color, *self.size_wh, self._vendor.format.rgb8, self._rate_hz)
        if self._config.depth:
            asked.enable_stream(self._vendor.stream.depth, self._vendor.format.z16, self._rate_hz)
        self._clock = StampClock()
        self._pipeline: Any = self._vendor.pipeline()
        started = self._pipeline.start(asked)
        if self._config.depth:
            self._align: Any = self._vendor.align(self._vendor.stream.color)
            sensor = started.get_device().first_depth_sensor()
            self._unit_m, self._noise = float(sensor.get_depth_scale()), self._noise_of(started, sensor)

    def _noise_of(self, started: Any, sensor: Any) -> DepthNoise:
        """By the camera's own focal length and baseline, where it is a stereo camera."""
        baseline = self._vendor.option.stereo_baseline
        if not sensor.supports(baseline):
            return DepthNoise()
        stream = started.get_stream(self._vendor.stream.depth).as_video_stream_profile()
        return DepthNoise(focal_px=float(stream.get_intrinsics().fx), baseline_m=float(sensor.get_option(baseline)) / MM_PER_M)

    def frames(self) -> Iterator[Frame]:
        """Frames as they come; raises SourceError when they stop coming."""
        while self._running:
            try:
                together = self._pipeline.wait_for_frames(round(1000 * self._config.read_s))
                together = self._align.process(together) if self._config.depth else together
                color = together.get_color_frame()
            except RuntimeError as error:
                raise SourceError(f"{self._where}: no image any more ({error})") from None
            if not color:
                continue
            arrived_ns = time.monotonic_ns() + self._epoch_ns
            self._newest_ns = max(self._newest_ns + 1, self._exposed_ns(color, arrived_ns))
            # the library uses its memory again
            image = np.array(color.get_data())
            yield Frame(
                camera=self.camera, seq=int(color.get_frame_number()), t_ns=self._newest_ns, received_ns=arrived_ns, image=image,
                depth=self._depth_of(together),
            )  # fmt: skip

    def _depth_of(self, together: Any) -> DepthImage | None:
        depth = together.get_depth_frame() if self._config.depth else None
        return DepthImage(values=np.array(depth.get_data()), unit_m=self._unit_m, noise=self._noise) if depth else None

    def _exposed_ns(self, color: Any, arrived_ns: int) -> int:
        stamp_ns = round(color.get_timestamp() * 1e6)
        if color.get_frame_timestamp_domain() == self._vendor.timestamp_domain.hardware_clock:
            read_ns = self._clock.placed(stamp_ns, arrived_ns)
        else:
            # the machine's clock may have been set since the start, the session's has not
            read_ns = arrived_ns - (time.time_ns() - stamp_ns)
        return read_ns - self._exposed_before_ns(color)

    def _exposed_before_ns(self, color: Any) -> int:
        known = self._vendor.frame_metadata_value
        if not all(color.supports_frame_metadata(key) for key in (known.frame_timestamp, known.sensor_timestamp)):
            return 0
        before_us = color.get_frame_metadata(known.frame_timestamp) - color.get_frame_metadata(known.sensor_timestamp)
        return 1000 * max(0, int(before_us))
