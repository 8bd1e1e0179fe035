"""Colour stream of an OAK camera (DepthAI 3), timed at mid-exposure; the maker's library gives times of this machine's clock."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import numpy as np

from posefuse.core import Frame, SourceError

from .depth_camera import ANY, chosen, vendor_module, wanted_size

_NEWEST = 2


@dataclass(frozen=True)
class OakConfig:
    """One OAK camera.

    Attributes:
        camera: name of the camera in the rig. serial: its device id; ``any`` takes the first that is found.
        size: ``WIDTHxHEIGHT@RATE``.
        read_s: a camera that says nothing for so long is lost.
    """

    camera: str
    serial: str = ANY
    size: str = "640x480@30"
    read_s: float = 5.0

    def build(self) -> OakSource:
        """Start the stream; raises DependencyError without ``depthai``, SourceError when there is no such camera."""
        return OakSource(self)


class OakSource:
    """Frames of one camera in RGB; times are Unix epoch by the machine's clock, mid-exposure."""

    def __init__(self, config: OakConfig) -> None:
        self._config = config
        self._dai = vendor_module("depthai", "oak")
        width, height, rate = wanted_size(self._where, config.size)
        self._size_wh = width, height
        found = {info.getDeviceId(): info for info in self._dai.Device.getAllAvailableDevices()}
        serial = chosen(self._where, config.serial, list(found))
        try:
            self._pipeline: Any = self._dai.Pipeline(self._dai.Device(found[serial]))
            # A is the colour lens
            lens = self._pipeline.create(self._dai.node.Camera).build(self._dai.CameraBoardSocket.CAM_A)
            stream = lens.requestOutput((width, height), self._dai.ImgFrame.Type.RGB888i, fps=float(rate))
            self._queue: Any = stream.createOutputQueue(_NEWEST, False)
            self._pipeline.start()
        except RuntimeError as error:
            raise SourceError(f"{self._where}: cannot deliver {config.size} ({error})") from None
        self._running = True
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._newest_ns = 0

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
                taken = self._queue.get(timedelta(seconds=self._config.read_s))
            except RuntimeError as error:
                raise SourceError(f"{self._where}: no image any more ({error})") from None
            if taken is None:
                raise SourceError(f"{self._where}: no image for {self._config.read_s:g} s")
            arrived_ns = time.monotonic_ns() + self._epoch_ns
            exposed_ns = taken.getTimestamp(self._dai.CameraExposureOffset.MIDDLE) // timedelta(microseconds=1) * 1000
            self._newest_ns = max(self._newest_ns + 1, exposed_ns + self._epoch_ns)
            image = np.array(taken.getFrame())
            yield Frame(self.camera, int(taken.getSequenceNum()), self._newest_ns, arrived_ns, image)

    def close(self) -> None:
        """Stop the stream; safe to call twice."""
        if self._running:
            self._running = False
            self._pipeline.stop()

    @property
    def _where(self) -> str:
        return f"OAK {self._config.serial}: camera {self.camera}"
