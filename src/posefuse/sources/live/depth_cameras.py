"""Colour streams of RealSense and OAK cameras (DepthAI 3), timed by the camera at mid-exposure, and their depth aligned with it.

They are found by serial number and asked for a size. The clock of a RealSense camera is turned into the machine's by the maker's
library ("global time"). Its stamp is when the image began to be read out; the time from the middle of the exposure to the
readout follows from two numbers of the camera's own clock. OAK's library gives times of this machine's clock.
"""

from __future__ import annotations

import re
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, ClassVar

import numpy as np

from posefuse.core import Frame, SourceError
from posefuse.core.depth import MM_PER_M, DepthImage, DepthNoise
from posefuse.core.errors import choices
from posefuse.core.extras import package_of_extra

from .stream import StampClock

_ANY = "any"


@dataclass(frozen=True)
class DepthCameraConfig:
    """The colour stream of one camera, and its depth.

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


class DepthCamera(ABC):
    """Frames of one camera in RGB; times are Unix epoch by the machine's clock, mid-exposure.

    `maker` names it to people, `extra` is the extra of posefuse that brings `library`, the maker's own.
    """

    maker: ClassVar[str]
    library: ClassVar[str]
    extra: ClassVar[str]
    _pipeline: Any  # of the vendor's library; `_start` sets it

    def __init__(self, config: DepthCameraConfig) -> None:
        self._config = config
        self.camera = config.camera
        self._vendor: Any = package_of_extra(self.library, self.extra)
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
        return f"{self.maker} {self._config.serial}: camera {self.camera}"

    @abstractmethod
    def _serials(self) -> list[str]:
        """The cameras that are connected."""

    @abstractmethod
    def _start(self, serial: str) -> None:
        """Start the stream, leaving what stops it in `_pipeline`; raises the library's RuntimeError."""


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


@dataclass(frozen=True)
class RealSenseConfig(DepthCameraConfig):
    """One RealSense camera."""

    def build(self) -> RealSenseSource:
        """Start the stream; raises DependencyError without ``pyrealsense2``, SourceError when there is no such camera."""
        return RealSenseSource(self)


class RealSenseSource(DepthCamera):
    """Frames of one RealSense camera."""

    maker, library, extra = "RealSense", "pyrealsense2", "realsense"

    def _serials(self) -> list[str]:
        devices = self._vendor.context().query_devices()
        return [device.get_info(self._vendor.camera_info.serial_number) for device in devices]

    def _start(self, serial: str) -> None:
        asked = self._vendor.config()
        asked.enable_device(serial)
        asked.enable_stream(self._vendor.stream.color, *self.size_wh, self._vendor.format.rgb8, self._rate_hz)
        if self._config.depth:
            asked.enable_stream(self._vendor.stream.depth, self._vendor.format.z16, self._rate_hz)
        self._clock = StampClock(0)
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


_NEWEST = 2
# of the two lenses that depth comes from: OAK-D has 7.5 cm between them and a field of view of 72 degrees
_STEREO_WH, _NOISE = (640, 400), DepthNoise(focal_px=440.0, baseline_m=0.075)
_COLOR, _DEPTH = "color", "depth"


@dataclass(frozen=True)
class OakConfig(DepthCameraConfig):
    """One OAK camera."""

    def build(self) -> OakSource:
        """Start the stream; raises DependencyError without ``depthai``, SourceError when there is no such camera."""
        return OakSource(self)


class OakSource(DepthCamera):
    """Frames of one OAK camera."""

    maker, library, extra = "OAK", "depthai", "oak"

    def _serials(self) -> list[str]:
        return [info.getDeviceId() for info in self._vendor.Device.getAllAvailableDevices()]

    def _start(self, serial: str) -> None:
        known = {info.getDeviceId(): info for info in self._vendor.Device.getAllAvailableDevices()}
        self._pipeline: Any = self._vendor.Pipeline(self._vendor.Device(known[serial]))
        # A is the colour lens
        lens = self._pipeline.create(self._vendor.node.Camera).build(self._vendor.CameraBoardSocket.CAM_A)
        stream = lens.requestOutput(self.size_wh, self._vendor.ImgFrame.Type.RGB888i, fps=float(self._rate_hz))
        given = self._with_depth(stream).out if self._config.depth else stream
        self._queue: Any = given.createOutputQueue(_NEWEST, False)
        self._pipeline.start()

    def _with_depth(self, color: Any) -> Any:
        """The node that gives color and depth of one time together, depth aligned with color."""
        node, sockets = self._vendor.node, self._vendor.CameraBoardSocket
        stereo, sync = self._pipeline.create(node.StereoDepth), self._pipeline.create(node.Sync)
        for socket, side in ((sockets.CAM_B, stereo.left), (sockets.CAM_C, stereo.right)):
            lens = self._pipeline.create(node.Camera).build(socket)
            lens.requestOutput(_STEREO_WH, fps=float(self._rate_hz)).link(side)
        color.link(sync.inputs[_COLOR])
        if self._pipeline.getDefaultDevice().getPlatform() == self._vendor.Platform.RVC2:
            color.link(stereo.inputAlignTo)
            stereo.depth.link(sync.inputs[_DEPTH])
        else:
            align = self._pipeline.create(node.ImageAlign)
            stereo.depth.link(align.input)
            color.link(align.inputAlignTo)
            align.outputAligned.link(sync.inputs[_DEPTH])
        return sync

    def frames(self) -> Iterator[Frame]:
        """Frames as they come; raises SourceError when they stop coming."""
        while self._running:
            try:
                taken = self._queue.get(timedelta(seconds=self._config.read_s))
            except RuntimeError as error:
                raise SourceError(f"{self._where}: no image any more ({error})") from None
            if taken is None:
                raise SourceError(f"{self._where}: no image for {self._config.read_s:g} s")
            depth = None
            if self._config.depth:
                depth = DepthImage(values=np.array(taken[_DEPTH].getFrame()), noise=_NOISE)
                taken = taken[_COLOR]
            arrived_ns = time.monotonic_ns() + self._epoch_ns
            exposed_ns = taken.getTimestamp(self._vendor.CameraExposureOffset.MIDDLE) // timedelta(microseconds=1) * 1000
            self._newest_ns = max(self._newest_ns + 1, exposed_ns + self._epoch_ns)
            image = np.array(taken.getFrame())
            yield Frame(
                camera=self.camera, seq=int(taken.getSequenceNum()), t_ns=self._newest_ns, received_ns=arrived_ns, image=image,
                depth=depth,
            )  # fmt: skip
