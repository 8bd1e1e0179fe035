"""A video file played as if its camera were there: frames come when they are due."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from posefuse.core import Frame
from posefuse.core.frames import EncodedFrame
from posefuse.sources.arriving import with_earlier
from posefuse.sources.video import VideoConfig, VideoSource

# decoding takes time, too; the first frame may be this late, because its successor is unknown
_SLACK_NS, _FIRST_NS = 15_000_000, 100_000_000
# a computer that is too slow for the file is given a frame late then
_LONGEST_GAP_S = 1.0


@dataclass(frozen=True)
class PacedVideoConfig:
    """A video file at wall-clock pace.

    Attributes:
        path: the file. camera: name of the camera in the rig.
        offset_s: added to the file's times; positive when this file began later than the others.
        zero_ns: monotonic time at which the file shows its time 0, so that several cameras agree; None is when the first
            frame is asked for.
        keep_encoded: give every frame in the file's own encoding too.
    """

    path: Path
    camera: str
    offset_s: float = 0.0
    zero_ns: int | None = None
    keep_encoded: bool = False

    def build(self) -> PacedVideoSource:
        """Open the file and look at its first frame; raises SourceError when that cannot be done."""
        return PacedVideoSource(self)


class PacedVideoSource:
    """Frames of a video file at their times; one that could not be decoded before the next was due may be left out."""

    def __init__(self, config: PacedVideoConfig) -> None:
        self._config = config
        self.camera = config.camera
        self._video: VideoSource = VideoConfig(
            config.path, config.camera, config.offset_s, keep_encoded=config.keep_encoded, threads=False
        ).build()
        self.size_wh = self._video.size_wh

    def frames(self) -> Iterator[Frame]:
        """Frames in time order; `received_ns` is when a frame was handed on, on the file's own clock."""
        zero_ns = self._config.zero_ns if self._config.zero_ns is not None else time.monotonic_ns()
        period_ns, before_ns, given_s = _FIRST_NS, None, time.monotonic()
        frame: Frame | None = None
        left_out: list[tuple[int, EncodedFrame | None]] = []
        for frame in self._video.frames():
            period_ns = frame.t_ns - before_ns if before_ns is not None else period_ns
            before_ns = frame.t_ns
            now_ns = time.monotonic_ns() - zero_ns
            if now_ns > frame.t_ns + period_ns + _SLACK_NS and time.monotonic() - given_s < _LONGEST_GAP_S:
                left_out.append((frame.t_ns, frame.encoded))
                continue
            time.sleep(max(0, frame.t_ns - now_ns) / 1e9)
            given_s = time.monotonic()
            yield _given(frame, left_out, zero_ns)
            left_out = []
        # there is no other that the packets of the last one could go with
        if frame is not None and left_out:
            yield _given(frame, left_out[:-1], zero_ns)

    def close(self) -> None:
        """Nothing stays open between calls of `frames`."""
        self._video.close()


def _given(frame: Frame, left_out: Sequence[tuple[int, EncodedFrame | None]], zero_ns: int) -> Frame:
    received_ns = time.monotonic_ns() - zero_ns
    return dataclasses.replace(frame, image=frame.pixels, received_ns=received_ns, encoded=with_earlier(frame, left_out))
