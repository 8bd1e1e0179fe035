"""Videos that are written while a camera delivers them: its own packets where it encodes, a fast encoding where it does not."""

from __future__ import annotations

import heapq
import io
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np

from posefuse.core import Closing, InputError
from posefuse.core.frames import EncodedFrame, Packet, Pixels

from .video import TIME_BASE, h264_stream, open_mp4, reason

# The packets of a stream in the order of decoding, until the frames in them have been shown and their times are known.

# between the first times of decoding
_STEP_US = 1000
_NEVER_NS = -(2**63)


@dataclass(frozen=True, eq=False, kw_only=True)
class TimedPacket:
    """A packet with the times, in microseconds, when its frame is shown and when a decoder needs it."""

    packet: Packet
    shown_us: int
    decoded_us: int


class PacketQueue:
    """Places packets on a session's clock: at the time of their frame, or by their stamp where they gave no frame.

    It begins with a keyframe, and again after packets that are missing.
    """

    def __init__(self) -> None:
        self._waiting: deque[Packet] = deque()
        # when the frames of those that wait were shown, by stamp; and stamp and time of the newest one
        self._shown_us: dict[int, int] = {}
        self._newest: tuple[int, int] | None = None
        self._next_number: int | None = None
        self._first_stamp_ns = _NEVER_NS
        # the next times of decoding: as many as there are frames that may be shown after one that follows them
        self._decoded_us: list[int] = []
        self._last_decoded_us: int | None = None

    def begins_again(self, frame: EncodedFrame) -> bool:
        """Whether packets before those of this frame are missing."""
        return frame.number != self._next_number

    def add(self, frame: EncodedFrame, t_us: int) -> bool:
        """Add a frame that is shown at `t_us`; False if no keyframe has come since packets were missing: it cannot be decoded."""
        if self.begins_again(frame) and not self._begin(frame.packets):
            return False
        self._next_number = frame.number + len(frame.packets)
        # others follow the first keyframe, but are shown before it and need what is missing
        self._waiting.extend(packet for packet in frame.packets if packet.stamp_ns >= self._first_stamp_ns)
        if frame.stamp_ns < self._first_stamp_ns:
            return False
        if self._last_decoded_us is None and not self._decoded_us:
            self._decoded_us = [t_us - _STEP_US * before for before in range(frame.reorder_depth, 0, -1)]
        # now that it was shown, what comes with an older stamp is of a clock that was set back
        self._first_stamp_ns = _NEVER_NS
        self._shown_us[frame.stamp_ns] = t_us
        self._newest = frame.stamp_ns, t_us
        return True

    def due(self) -> Iterator[TimedPacket]:
        """Those at the head whose times are known."""
        while self._waiting and self._newest is not None and self._waiting[0].stamp_ns <= self._newest[0]:
            yield from self._timed(self._waiting.popleft(), *self._newest)

    def rest(self) -> Iterator[TimedPacket]:
        """At the end: those that frames which were shown need."""
        while self._newest is not None and any(packet.stamp_ns in self._shown_us for packet in self._waiting):
            yield from self._timed(self._waiting.popleft(), *self._newest)

    def _begin(self, packets: Sequence[Packet]) -> bool:
        self._waiting.clear()
        self._shown_us.clear()
        self._newest = self._next_number = None
        first = next((packet for packet in packets if packet.keyframe), None)
        if first is None:
            return False
        self._first_stamp_ns = first.stamp_ns
        return True

    def _timed(self, packet: Packet, newest_ns: int, newest_us: int) -> Iterator[TimedPacket]:
        shown_us = self._shown_us.pop(packet.stamp_ns, newest_us + round((packet.stamp_ns - newest_ns) / 1000))
        decoded_us = heapq.heappushpop(self._decoded_us, shown_us)
        if self._last_decoded_us is None or decoded_us > self._last_decoded_us:
            self._last_decoded_us = decoded_us
            yield TimedPacket(packet=packet, shown_us=shown_us, decoded_us=decoded_us)


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
COPIED, ENCODED = "copied", "encoded"
_OTHER = "the camera came back with images of another size or encoding"


class KeptVideo(Closing):
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
        self._container: Any = open_mp4(path, _CONTAINER)

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
            raise InputError(f"{self.path}: cannot be written ({reason(error)})") from None
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
            raise InputError(f"{self.path}: cannot be finished ({reason(error)})") from None

    def _begin(self, image: Pixels | EncodedFrame) -> None:
        if isinstance(image, EncodedFrame):
            self.how, self._header = COPIED, image.header
            with av.open(io.BytesIO(image.header), format="mp4") as template:
                self._stream = self._container.add_stream_from_template(template.streams.video[0], opaque=True)
            self._stream.time_base = TIME_BASE
        else:
            self.how, self._size_wh = ENCODED, image.size_wh
            self._stream = h264_stream(self._container, image.size_wh, 30, _ENCODING)

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
