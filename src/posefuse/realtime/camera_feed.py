"""Cameras watched without tracking: the newest frame of each on one clock, and every frame to its camera's video."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from posefuse.core import Frame, Rig, SourceError
from posefuse.health.cameras import CameraState

from .capture import Capture, LiveInput, keeping_packets
from .clock import SessionClock
from .video_keeping import VideoKeeper, wait_for_videos

_FIRST_S = 30.0


@dataclass(frozen=True, eq=False)
class FedFrame:
    """The newest frame of one camera.

    Attributes:
        camera: its number. t_ns: time of exposure since the session's zero. frame: the image.
    """

    camera: int
    t_ns: int
    frame: Frame


class CameraFeed:
    """Cameras that are open inside the block and deliver from `begin` on; a context manager.

    Args:
        inputs: one per camera. rig: whose image sizes they must have; None takes any.
        packets: give frames in the camera's own encoding too, for videos.

    Raises:
        SourceError: at the start of the block: a source that cannot be opened.
    """

    def __init__(self, inputs: Sequence[LiveInput], *, rig: Rig | None = None, packets: bool = False) -> None:
        self.cameras = tuple(entry.camera for entry in inputs)
        self._news = threading.Condition()
        # when the first frames were asked for, and when each camera had delivered one
        self._begun_s = 0.0
        self._all_s: float | None = None
        self._captures = [
            Capture(keeping_packets(entry) if packets else entry, None if rig is None else rig[entry.camera], self._news)
            for entry in inputs
        ]

    def __enter__(self) -> CameraFeed:
        try:
            for capture in self._captures:
                capture.open()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def begin(self, videos: Path | None = None) -> None:
        """Let frames come. With `videos`, an existing folder, all go to ``CAMERA.mp4`` there, each at its own time.

        Raises:
            InputError: a video that cannot be made.
        """
        for capture in self._captures:
            if videos is not None:
                capture.keep(VideoKeeper(videos, capture.entry.camera))
        self._begun_s = time.monotonic()
        zero_ns, clock = time.monotonic_ns(), SessionClock.begin()
        for capture in self._captures:
            capture.begin(zero_ns, zero_ns + clock.offset_ns)

    def close(self) -> None:
        """Close the sources and finish the videos; safe to call twice."""
        captures, self._captures = self._captures, []
        wait_for_videos([keeper for capture in captures for keeper in capture.close()])

    def newest(self) -> list[FedFrame]:
        """What came since the last call, the newest frame of each camera.

        All at once, before any is looked at: frames of one moment show which cameras see a target together.
        """
        with self._news:
            taken = [capture.take() for capture in self._captures]
        return [
            FedFrame(number, caught.arrived.t_ns + caught.later_ns - capture.zero_ns, caught.arrived.frame())
            for number, (capture, caught) in enumerate(zip(self._captures, taken, strict=True))
            if caught is not None
        ]

    def states(self) -> tuple[CameraState, ...]:
        """Status of each camera."""
        return tuple(capture.state() for capture in self._captures)

    def seconds(self) -> float:
        """Since the first frame of the last camera; one that has sent none for half a minute is not waited for."""
        now_s = time.monotonic()
        if self._all_s is None and (now_s - self._begun_s > _FIRST_S or all(state.captured for state in self.states())):
            self._all_s = now_s
        return 0.0 if self._all_s is None else now_s - self._all_s

    @property
    def over(self) -> bool:
        """No camera will deliver any more."""
        return all(state.state == "ended" and not capture.entry.reopen
                   for capture, state in zip(self._captures, self.states(), strict=True))  # fmt: skip

    def check(self) -> None:
        """Raise SourceError for a source that failed and is not opened again."""
        for capture, state in zip(self._captures, self.states(), strict=True):
            if state.state == "lost" and not capture.entry.reopen:
                raise SourceError(state.text)
