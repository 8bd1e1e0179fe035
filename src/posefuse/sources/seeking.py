"""Any frame of a recording at once: for players, which jump about in a video instead of reading it from the start."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Lock
from typing import Protocol

import av
import numpy as np
from av.video.frame import VideoFrame

from posefuse.core import Frame, SourceError
from posefuse.core.arrays import Array
from posefuse.core.view_sequences import nearest_frames
from posefuse.formats.video import DecodedPixels, PixelConverter

from .images import ImagesSource
from .video import VideoConfig, listed_frames, opened_video

# a jump costs about as much as so many frames
_READ_ON = 8


class Seeker(Protocol):
    """The frames of one camera, in any order; may be asked from several threads."""

    @property
    def times_ns(self) -> Array:
        """(F,) session times of all frames, increasing."""
        ...

    def at(self, i: int) -> Frame:
        """Frame i; raises SourceError where it cannot be decoded."""
        ...

    def close(self) -> None:
        """Release the file."""
        ...


def nearest(times_ns: Array, t_ns: int) -> int:
    """The place of the frame nearest in time."""
    return int(nearest_frames(times_ns, np.array(t_ns)))


class VideoSeeker:
    """Frames of a video file by the index of its packets: a jump decodes from the key frame before, not from the start.

    Reading on from frame to frame decodes each once.

    Attributes:
        times_ns: (F,) session times of all frames that the file lists.

    Raises:
        SourceError: the file cannot be opened, or lists no frame.
    """

    def __init__(self, config: VideoConfig) -> None:
        self._config, self._lock = config, Lock()
        self._container = opened_video(config)
        self._stream = self._container.streams.video[0]
        # frames at once come later: after each jump, as many more are decoded as there are threads
        self._stream.thread_type = "AUTO" if config.threads else "NONE"
        listed = self._listed = listed_frames(self._container)
        if not listed.ticks:
            self._container.close()
            raise SourceError(f"{config.where}: no frame is listed; is the file complete?")
        self._ticks = np.array(listed.ticks, np.int64)
        self._keys = np.array([*listed.keys] or listed.ticks[:1], np.int64)
        self.times_ns = listed.times_ns(config)
        self._pixels = PixelConverter()
        self._decoding: Iterator[VideoFrame] = iter(())
        self._last: tuple[int, VideoFrame] | None = None

    def at(self, i: int) -> Frame:
        """Frame i, or the first after it that can be decoded."""
        with self._lock:
            tick = int(self._ticks[i])
            if self._last is None or self._last[0] != tick:
                self._last = self._reach(tick)
            decoded = self._last[1]
            image = DecodedPixels(decoded, self._pixels).rgb()
        t_ns = int(self.times_ns[i])
        return Frame(camera=self._config.camera, seq=i, t_ns=t_ns, received_ns=t_ns, image=image)

    def close(self) -> None:
        """Release the file."""
        with self._lock:
            self._container.close()

    def _reach(self, tick: int) -> tuple[int, VideoFrame]:
        """Decode to the frame of this time: on from the last one where that is near, else from a key frame before."""
        key = max(int(np.searchsorted(self._keys, tick, "right")) - 1, 0)
        if self._last is not None and self._is_near(self._last[0], tick, int(self._keys[key])):
            found = self._first_from(tick)
            if found is not None:
                return tick, found
        # containers without an index may land behind the key frame that was asked for: then one key frame earlier
        for place in range(key, -1, -1):
            self._container.seek(int(self._keys[place]) if place else 0, stream=self._stream)
            self._decoding = self._decoded()
            found = self._first_from(tick, whole=place > 0)
            if found is not None:
                return tick, found
        self._last = None
        time_s = float(tick * self._listed.base_s)
        raise SourceError(f"{self._config.where}: frame at {time_s:.3f} s of the file cannot be decoded")

    def _is_near(self, last: int, tick: int, key: int) -> bool:
        """Whether reading on from the last frame decodes hardly more than starting at the key frame."""
        at, begin = np.searchsorted(self._ticks, (last, key))
        return last < tick and int(at) + _READ_ON >= int(begin)

    def _first_from(self, tick: int, *, whole: bool = False) -> VideoFrame | None:
        """The first frame from a time on; None where there is none, or, with `whole`, where nothing before it was decoded."""
        before = False
        for decoded in self._decoding:
            if decoded.pts is None:
                continue
            if decoded.pts == tick or (decoded.pts > tick and (before or not whole)):
                return decoded
            if decoded.pts > tick:
                return None
            before = True
        return None

    def _decoded(self) -> Iterator[VideoFrame]:
        """Frames from here on; packets that cannot be decoded are left out."""
        for packet in self._container.demux(self._stream):
            try:
                yield from packet.decode()
            except av.error.FFmpegError:
                continue


class ImagesSeeker:
    """Frames of an image folder, all of them at `times_ns` (F,)."""

    def __init__(self, source: ImagesSource) -> None:
        self._source, self.times_ns = source, source.times_ns()

    def at(self, i: int) -> Frame:
        """Frame i."""
        frame = self._source.at(i)
        if frame is None:
            raise SourceError(f"{self._source.paths()[i]}: cannot be read as an image")
        return frame

    def close(self) -> None:
        """Nothing stays open between frames."""
