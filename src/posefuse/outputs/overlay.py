"""Output ``overlay``: a video of all views side by side with the skeleton on top."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Le

from posefuse.core import Recording
from posefuse.core.arrays import Array
from posefuse.foundation.output_file import atomic_file
from posefuse.foundation.settings import settings

from .drawing import draw_legend, draw_views, empty_row, grid_for
from .facts import rate_hz
from .frames import Frames, FrameWriter, ImageOutput, OneFileWriter

_WAITING = 3


class Background:
    """Calls a function in one other thread, in the order of the calls, a few of which may wait.

    What the function raises is raised by a later `call`, or by `close`.
    """

    def __init__(self, function: Callable[..., object], name: str) -> None:
        self._function = function
        self._pool = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._pending: deque[Future[object]] = deque()

    def call(self, *args: Any) -> None:
        """Do it later; waits while too many wait already."""
        while len(self._pending) >= _WAITING:
            self._pending.popleft().result()
        self._pending.append(self._pool.submit(self._function, *args))

    def close(self) -> None:
        """Wait until all is done; safe to call twice. After an error, calls that have not begun are left out."""
        try:
            while self._pending:
                self._pending.popleft().result()
        finally:
            for future in self._pending:
                future.cancel()
            self._pending.clear()
            self._pool.shutdown()


# of the encoder; the same on every machine, so that the file does not depend on the number of cores
_THREADS = 2
# x264's constant rate factor; lower is better and larger
_CRF = 26
# below what may be written about a view
_LEGEND_LINE = 4


@settings
class OverlaySink(ImageOutput):
    """``overlay.mp4``: every view with the fused skeleton (left orange, right blue) and its raw detections (crosses).

    Attributes:
        width_px, height_px: the video fits into this.
    """

    width_px: Annotated[int, Ge(64), Le(7680)] = 1280
    height_px: Annotated[int, Ge(64), Le(4320)] = 960
    name: ClassVar[str] = "overlay"

    def writer(self, recording: Recording, folder: Path) -> FrameWriter:
        """Begin ``overlay.mp4``; frames come one set at a time."""
        return _OverlayWriter(recording, folder / "overlay.mp4", self)


class _OverlayWriter(OneFileWriter):
    def __init__(self, recording: Recording, path: Path, config: OverlaySink) -> None:
        super().__init__(recording, path)
        self._grid = grid_for([camera.size_wh for camera in recording.rig], (config.width_px, config.height_px))

    def __enter__(self) -> _OverlayWriter:
        from posefuse.formats.video import VideoWriter

        staged = self._whole.enter_context(atomic_file(self._path))
        rate = rate_hz(self._recording.poses)
        self._video = VideoWriter(staged, self._grid.size_wh, rate, _CRF, preset="superfast", threads=_THREADS)
        self._whole.callback(self._video.close)
        self._encoding = Background(self._video.encode, "encode overlay")
        self._whole.callback(self._encoding.close)
        self._converting = Background(self._convert, "convert overlay")
        self._whole.callback(self._converting.close)
        return self

    def add(self, i: int, frames: Frames) -> None:
        width, height = self._grid.size_wh
        picture = np.empty((height, width, 3), np.uint8)
        picture[:] = empty_row(width)
        draw_views(picture, self._grid, self._recording, i, [None if frame is None else frame.image for frame in frames])
        draw_legend(picture[: self._grid.tile_wh[1], : self._grid.tile_wh[0]], _LEGEND_LINE)
        t_ns = self._recording.poses.t_ns
        self._converting.call(picture, int(t_ns[i] - t_ns[0]))

    def _convert(self, picture: Array, t_ns: int) -> None:
        self._encoding.call(self._video.converted(picture, t_ns))
