"""Colour stream of an OAK camera (DepthAI 3), timed at mid-exposure, and its stereo depth aligned with it.

The maker's library gives times of this machine's clock.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import numpy as np

from posefuse.core import Frame, SourceError
from posefuse.core.depth import DepthImage, DepthNoise

from .depth_camera import DepthCamera, DepthCameraConfig

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
