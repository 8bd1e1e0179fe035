"""What the Rerun views of cameras at work share: when they are open, how often they draw, and how large."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar

import cv2

from posefuse.core import Frame
from posefuse.core.arrays import Array

_SHOWN_PX = 640
F_contra = TypeVar("F_contra", contravariant=True)


class FrameView(Protocol[F_contra]):
    """Shows frames until it is closed."""

    def look(self, look: F_contra, /) -> None:
        """Show one frame."""

    def close(self) -> None:
        """Finish the stream."""


@contextmanager
def frame_view(place: str | None, opened: Callable[[str], FrameView[F_contra]]) -> Iterator[Callable[[F_contra], None]]:
    """What to do with every frame: show it in the view that is `opened` at `place`, or nothing (None)."""
    if place is None:
        yield lambda look: None
        return
    view = opened(place)
    try:
        yield view.look
    finally:
        view.close()


class DrawPace:
    """Which frames to draw, so that every camera is drawn at a pace an eye can follow."""

    def __init__(self, every_ns: int) -> None:
        self._every_ns = every_ns
        self._drawn_ns: dict[int, int] = {}

    def due(self, camera: int, t_ns: int) -> bool:
        """Whether to draw this frame; the next one is due `every_ns` later."""
        last_ns = self._drawn_ns.get(camera)
        if last_ns is not None and t_ns - last_ns < self._every_ns:
            return False
        self._drawn_ns[camera] = t_ns
        return True


def small_image(frame: Frame) -> tuple[Array, float]:
    """An image of at most 640 px a side, and its scale."""
    factor = min(1.0, _SHOWN_PX / max(frame.size_wh))
    width, height = (round(side * factor) for side in frame.size_wh)
    return cv2.resize(frame.image, (width, height), interpolation=cv2.INTER_AREA), factor
