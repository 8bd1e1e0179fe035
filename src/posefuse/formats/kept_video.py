"""Videos that are written while a camera delivers them: its own packets where it encodes, a fast encoding where it does not."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import av
import numpy as np

from posefuse.core import InputError
from posefuse.core.encoded import EncodedFrame

from .packet_queue import PacketQueue, TimedPacket
from .pixels import Pixels
from .video import TIME_BASE

# of a session folder, one video per camera
VIDEOS_FOLDER = "videos"
# fragments of half a second: what was written stays readable when the program is killed; all times in microseconds, the first
# one included
_CONTAINER = {
    "movflags": "frag_keyframe+delay_moov+default_base_moof",
    "frag_duration": "500000",
    "flush_packets": "1",
    "movie_timescale": str(TIME_BASE.denominator),
    "video_track_timescale": str(TIME_BASE.denominator),
}
_ENCODING = {"preset": "ultrafast", "crf": "21", "threads": "1"}
_KEYFRAME_EVERY = 60
COPIED, ENCODED = "copied", "encoded"
_OTHER = "the camera came back with images of another size or encoding"


@dataclass(frozen=True, kw_only=True)
class KeptTimes:
    """Attributes:
    zero_ns: time 0 of the video on the session's clock. first_ns, last_ns: its first and last frame, from there.
    """

    zero_ns: int
    first_ns: int
    last_ns: int


def read_kept_times(video: Path) -> KeptTimes | None:
    """When a video was kept, from the ``CAMERA.json`` next to it; None where that is missing, or the video was not finished."""
    try:
        content = json.loads(video.with_suffix(".json").read_text(encoding="utf-8"))
        if not (content["finished"] and content["written"] and content["zero_ns"]):
            return None
        first_ns, last_ns = (round(1e9 * float(content[name])) for name in ("first_s", "last_s"))
        return KeptTimes(zero_ns=int(content["zero_ns"]), first_ns=first_ns, last_ns=last_ns)
    except (OSError, ValueError, TypeError, KeyError, OverflowError):
        return None


class KeptVideo:
    """One camera's frames to an .mp4, each with its own presentation time to the microsecond; a context manager.

    Whether packets are copied or images encoded is decided by the first frame. Packets are copied in the order of decoding,
    from the first keyframe on.

    Args:
        path: the file; must not exist.

    Attributes:
        how: `COPIED` or `ENCODED`, empty before the first frame. frames: how many it holds; after `close` all.

    Raises:
        InputError: it cannot be made, or already exists; from `write` and `close`: the disk is full.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.how, self.frames = path, "", 0
        self._last_us = -1
        self._stream: Any = None
        self._queue = PacketQueue()
        if path.exists():
            raise InputError(f"{path} already exists; no video is written over")
        if not path.parent.is_dir():
            raise InputError(f"{path}: cannot be written, there is no folder {path.parent}")
        try:
            self._container: Any = av.open(str(path), "w", format="mp4", options=_CONTAINER)
        except (av.error.FFmpegError, OSError) as error:
            raise InputError(f"{path}: cannot be written ({_reason(error)})") from None

    def __enter__(self) -> KeptVideo:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def write(self, image: Pixels | EncodedFrame, t_ns: int) -> str:
        """Add a frame of time `t_ns` (from 0 on), to be encoded or as its camera encoded it; "", or why it does not fit."""
        t_us = round(t_ns / 1000)
        if t_us <= self._last_us:
            return "their times are not later than those before"
        try:
            if self._stream is None:
                self._begin(image)
            if isinstance(image, EncodedFrame):
                problem = self._copy(image, t_us) if self.how == COPIED else _OTHER
            else:
                problem = self._encode(image, t_us) if self.how == ENCODED else _OTHER
        except (av.error.FFmpegError, OSError) as error:
            raise InputError(f"{self.path}: cannot be written ({_reason(error)})") from None
        if not problem:
            self._last_us = t_us
        return problem

    def close(self) -> None:
        """Finish the file; safe to call twice."""
        container, self._container = self._container, None
        if container is None:
            return
        try:
            if self.how == ENCODED and self._last_us >= 0:
                container.mux(self._stream.encode(None))
            self._mux(container, self._queue.rest())
            container.close()
        except (av.error.FFmpegError, OSError) as error:
            raise InputError(f"{self.path}: cannot be finished ({_reason(error)})") from None

    def _begin(self, image: Pixels | EncodedFrame) -> None:
        if isinstance(image, EncodedFrame):
            self.how, self._header = COPIED, image.header
            with av.open(io.BytesIO(image.header), format="mp4") as template:
                self._stream = self._container.add_stream_from_template(template.streams.video[0], opaque=True)
        else:
            self.how, self._size_wh = ENCODED, image.size_wh
            self._stream = self._container.add_stream("libx264", rate=30, options=_ENCODING)
            self._stream.width, self._stream.height = image.size_wh
            self._stream.pix_fmt = "yuv444p" if any(side % 2 for side in image.size_wh) else "yuv420p"
            self._stream.codec_context.max_b_frames = 0
            self._stream.codec_context.gop_size = _KEYFRAME_EVERY
            self._stream.codec_context.time_base = TIME_BASE
        self._stream.time_base = TIME_BASE

    def _copy(self, frame: EncodedFrame, t_us: int) -> str:
        if frame.header != self._header:
            return _OTHER
        if self._queue.begins_again(frame):
            self._mux(self._container, self._queue.rest())
        known = self._queue.add(frame, t_us)
        self._mux(self._container, self._queue.due())
        return "" if known else "packets that they need were lost"

    def _mux(self, container: Any, packets: Iterable[TimedPacket]) -> None:
        for timed in packets:
            packet = av.Packet(timed.packet.data)
            packet.pts, packet.dts, packet.time_base = timed.shown_us, timed.decoded_us, TIME_BASE
            packet.is_keyframe = timed.packet.keyframe
            packet.stream = self._stream
            container.mux(packet)
            self.frames += 1

    def _encode(self, pixels: Pixels, t_us: int) -> str:
        if pixels.size_wh != self._size_wh:
            return _OTHER
        image = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels.rgb()), format="rgb24")
        image.pts, image.time_base = t_us, TIME_BASE
        self._container.mux(self._stream.encode(image))
        self.frames += 1
        return ""


def _reason(error: Exception) -> str:
    """Without the path, which the message names already."""
    return getattr(error, "strerror", None) or str(error)
