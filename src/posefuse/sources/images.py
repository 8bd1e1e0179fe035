"""A folder of images as a source."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from posefuse.core import Frame, SourceError
from posefuse.core.arrays import Array
from posefuse.formats.image_folders import TIMES_FILE, read_frame_times

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")


@dataclass(frozen=True)
class ImagesConfig:
    """A folder with one image per frame, in the order of the numbers in their names.

    Attributes:
        path: the folder. Times come from its ``timestamps.csv`` (columns ``file``, ``t_s``) where there is one.
        camera: name of the camera in the rig.
        rate_hz: frame rate when the folder has no ``timestamps.csv``; None: unknown.
        offset_s: added to all times.
        drift_ppm: added per million of all times: positive when the camera's clock runs slow.
    """

    path: Path
    camera: str
    rate_hz: float | None = None
    offset_s: float = 0.0
    drift_ppm: float = 0.0

    def build(self) -> ImagesSource:
        """List the folder and read its first image; raises SourceError when that cannot be done, or no times are known."""
        return ImagesSource(self)


class ImagesSource:
    """Frames of an image folder; an image that cannot be read is left out."""

    def __init__(self, config: ImagesConfig) -> None:
        self._config = config
        self.camera = config.camera
        if config.rate_hz is not None and config.rate_hz <= 0:
            raise SourceError(f"{self._where}: rate_hz: expected > 0, got {config.rate_hz}")
        if not Path(config.path).is_dir():
            raise SourceError(f"{self._where}: no such folder")
        self._times_s = self._read_times()
        self.stated_frames = len(self._times_s)
        first = next(self.frames(), None)
        if first is None:
            raise SourceError(f"{self._where}: no readable image in the folder; known: {' '.join(IMAGE_SUFFIXES)}")
        self.size_wh = first.size_wh

    def times_ns(self) -> Array:
        """(F,) int64 session times of all frames, without reading them."""
        return np.array([self._session_ns(t) for _, t in self._times_s], dtype=np.int64)

    def _session_ns(self, time_s: float) -> int:
        return round((time_s * (1 + self._config.drift_ppm * 1e-6) + self._config.offset_s) * 1e9)

    def frames(self) -> Iterator[Frame]:
        """Frames in time order from the start."""
        return self._read(0)

    def frames_from(self, begin_ns: int) -> Iterator[Frame]:
        """See `RecordedSource`."""
        return self._read(int(np.searchsorted(self.times_ns(), begin_ns)))

    def _read(self, first: int) -> Iterator[Frame]:
        size_wh: tuple[int, int] | None = None
        for i, (path, time_s) in enumerate(self._times_s[first:], start=first):
            image = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
            if image is None:
                continue
            t_ns = self._session_ns(time_s)
            frame = Frame(camera=self.camera, seq=i, t_ns=t_ns, received_ns=t_ns, image=image)
            size_wh = size_wh or frame.size_wh
            if frame.size_wh != size_wh:
                raise SourceError(f"{self._where}: {path.name} is {frame.size_wh}, the first image was {size_wh} px")
            yield frame

    def close(self) -> None:
        """Nothing stays open between frames."""

    @property
    def _where(self) -> str:
        return f"{self._config.path}: camera {self._config.camera}"

    def _read_times(self) -> list[tuple[Path, float]]:
        folder = Path(self._config.path)
        if not (folder / TIMES_FILE).is_file():
            images = sorted((p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES), key=_by_numbers)
            if images and self._config.rate_hz is None:
                raise SourceError(
                    f"{self._where}: images do not state their frame rate; add `rate_hz=HZ`, rate_hz = HZ to posefuse.toml, "
                    f"or {TIMES_FILE} with columns file, t_s to the folder"
                )
            return [(path, i / (self._config.rate_hz or 1.0)) for i, path in enumerate(images)]
        return read_frame_times(folder)


def _by_numbers(path: Path) -> tuple[list[tuple[str, int]], str]:
    """Sorts frame 2 before frame 10: a text and the number after it, in turns; names that differ in zeros only by these."""
    return [(text, int(number or 0)) for text, number in re.findall(r"(\D*)(\d*)", path.name)], path.name
