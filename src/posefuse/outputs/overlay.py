"""Output ``overlay``: a video of all views side by side with the skeleton on top."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Le

from posefuse.core import Closing, Recording
from posefuse.foundation.output_file import atomic_file
from posefuse.foundation.settings import settings

from .drawing import draw_legend, draw_views, empty_row, grid_for
from .frames import Frames, ImageOutput, ShowStep
from .provenance import rate_hz

_WAITING = 3


class Background(Closing):
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
    file: ClassVar[str] = "overlay.mp4"

    @contextmanager
    def showing(self, recording: Recording, path: Path) -> Iterator[ShowStep]:
        """Images are converted in one thread and encoded in another, while the next ones are drawn."""
        from posefuse.formats.video import VideoWriter

        grid = grid_for([camera.size_wh for camera in recording.rig], (self.width_px, self.height_px))
        width, height = grid.size_wh
        t_ns = recording.poses.t_ns

        def show(i: int, frames: Frames) -> None:
            picture = np.empty((height, width, 3), np.uint8)
            picture[:] = empty_row(width)
            draw_views(picture, grid, recording, i, [None if frame is None else frame.image for frame in frames])
            draw_legend(picture[: grid.tile_wh[1], : grid.tile_wh[0]], _LEGEND_LINE)
            converting.call(picture, int(t_ns[i] - t_ns[0]))

        with (
            atomic_file(path) as staged,
            VideoWriter(staged, grid.size_wh, rate_hz(recording.poses), _CRF, preset="superfast", threads=_THREADS) as video,
            Background(video.encode, "encode overlay") as encoding,
            Background(lambda *image: encoding.call(video.converted(*image)), "convert overlay") as converting,
        ):
            yield show
