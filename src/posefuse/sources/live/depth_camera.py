"""What RealSense and OAK cameras have in common: found by serial number, asked for a size, timed by their own clock."""

from __future__ import annotations

import re
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

from posefuse.core import SourceError
from posefuse.core.errors import choices
from posefuse.core.extras import package_of_extra

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
