"""A recorded source whose frames get the depth images of a folder, by the times in its own file."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from posefuse.core import Frame, InputError, SourceError
from posefuse.core.arrays import Array
from posefuse.formats.depth_images import DepthFolder

from .coverage import RecordedSource


class DepthSource:
    """The same frames with depth, where the folder has an image of that time; implements `RecordedSource`.

    Args:
        source: videos or images. folder: see `formats.depth_images`.
        offset_s, drift_ppm: those of the source, which the names of the depth images do not contain.

    Raises:
        SourceError: the folder holds something else.
    """

    def __init__(self, source: RecordedSource, folder: Path, offset_s: float = 0.0, drift_ppm: float = 0.0) -> None:
        self._source, self._offset_ns, self._stretch = source, offset_s * 1e9, 1 + drift_ppm * 1e-6
        self.camera, self.size_wh = source.camera, source.size_wh
        try:
            self._depth = DepthFolder(folder)
        except (InputError, OSError) as error:
            raise SourceError(f"{folder}: camera {source.camera}: {error}") from None

    @property
    def stated_frames(self) -> int:
        """That of the source."""
        return self._source.stated_frames

    def times_ns(self) -> Array:
        """Those of the source."""
        return self._source.times_ns()

    def frames(self) -> Iterator[Frame]:
        """The source's frames; raises SourceError for a depth image that cannot be read."""
        return self._with_depth(self._source.frames())

    def frames_from(self, begin_ns: int) -> Iterator[Frame]:
        """See `RecordedSource`."""
        return self._with_depth(self._source.frames_from(begin_ns))

    def _with_depth(self, frames: Iterator[Frame]) -> Iterator[Frame]:
        for frame in frames:
            try:
                depth = self._depth.at(round((frame.t_ns - self._offset_ns) / self._stretch), frame.size_wh)
            except InputError as error:
                raise SourceError(f"camera {self.camera}: {error}") from None
            yield replace(frame, depth=depth)

    def close(self) -> None:
        """Close the source."""
        self._source.close()
