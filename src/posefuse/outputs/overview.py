"""Output ``overview``: one image of a result, views and 3D, for a report or a README."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Le

from posefuse.core import InputError, Kind, Recording
from posefuse.core.arrays import Array
from posefuse.foundation.output_file import atomic_file
from posefuse.foundation.settings import settings

from .drawing import EMPTY_RGB, grid_for, view_tile
from .frames import Frames, FrameSink, FrameWriter, write_without_frames
from .stage3d import stage_picture


@settings
class OverviewSink:
    """``overview.png``: the best seen time step near the middle in every view, and the scene in 3D next to them.

    Attributes:
        width_px, height_px: the views fit into this; the 3D image next to them has the same height.
    """

    width_px: Annotated[int, Ge(64), Le(7680)] = 1280
    height_px: Annotated[int, Ge(64), Le(4320)] = 720
    name: ClassVar[str] = "overview"

    def build(self) -> FrameSink:
        """This output, ready."""
        return self

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write ``overview.png`` on plain ground; returns the file made."""
        return write_without_frames(self, recording, folder)

    def writer(self, recording: Recording, folder: Path) -> FrameWriter:
        """Begin; the frames of one time step are kept."""
        return _OverviewWriter(recording, folder / "overview.png", self)


class _OverviewWriter:
    def __init__(self, recording: Recording, path: Path, config: OverviewSink) -> None:
        self._recording, self._path = recording, path
        self._most_wh = (config.width_px, config.height_px)
        self._instant = best_instant(recording)
        self._images: list[Array | None] = [None] * len(recording.rig)

    def __enter__(self) -> _OverviewWriter:
        return self

    def __exit__(self, *problem: object) -> None:
        if problem[0] is None:
            write_png(self._path, self._picture())

    @property
    def files(self) -> list[Path]:
        return [self._path]

    def add(self, i: int, frames: Frames) -> None:
        if i == self._instant:
            self._images = [None if frame is None else frame.image for frame in frames]

    def _picture(self) -> Array:
        grid = grid_for([camera.size_wh for camera in self._recording.rig], self._most_wh)
        width, height = grid.size_wh
        stage_width = max(320, min(height, width))
        picture = np.full((height, width + stage_width, 3), EMPTY_RGB, np.uint8)
        for c, image in enumerate(self._images):
            left, top = grid.corner(c)
            tile = view_tile(self._recording, self._instant, c, image, grid.tile_wh)
            picture[top : top + grid.tile_wh[1], left : left + grid.tile_wh[0]] = tile
        picture[:, width:] = stage_picture(self._recording, self._instant, (stage_width, height))
        return picture


def best_instant(recording: Recording) -> int:
    """The time step with the most measured keypoints; among equals the one nearest to the middle."""
    kind = recording.poses.kind
    measured = ((kind == Kind.FUSED) | (kind == Kind.SMOOTHED)).sum(axis=(1, 2))
    from_middle = np.abs(np.arange(len(kind)) - (len(kind) - 1) / 2) / max(1, len(kind))
    return int(np.argmax(measured - from_middle))


def write_png(path: Path, picture: Array) -> None:
    """Write an RGB image (H, W, 3); raises InputError when the place cannot be written to."""
    import cv2

    with atomic_file(path) as staged:
        if not cv2.imwrite(str(staged), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)):
            raise InputError(f"{path}: cannot be written")
