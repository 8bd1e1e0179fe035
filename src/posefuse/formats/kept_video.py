"""Videos that are written while a camera delivers them: its own packets where it encodes, a fast encoding where it does not."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import av
import numpy as np

from posefuse.core import Frame, InputError
from posefuse.core.encoded import EncodedImage

from .video import TIME_BASE

# of a session folder, one video per camera
VIDEOS_FOLDER = "videos"
# fragments: what was written stays readable when the program is killed; all times in microseconds, the first one included
_CONTAINER = {
    "movflags": "frag_keyframe+delay_moov+default_base_moof",
    "movie_timescale": str(TIME_BASE.denominator),
    "video_track_timescale": str(TIME_BASE.denominator),
}
_ENCODING = {"preset": "ultrafast", "crf": "21", "threads": "1"}
_KEYFRAME_EVERY = 60
COPIED, ENCODED = "copied", "encoded"


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

    Whether packets are copied or images encoded is decided by the first frame.

    Args:
        path: the file; must not exist.

    Raises:
        InputError: it cannot be made, or already exists; from `write` and `close`: the disk is full.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.how = path, ""
        self._last_us = -1
        self._stream: Any = None
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

    def write(self, frame: Frame, t_ns: int) -> bool:
        """Add a frame of time `t_ns` (from 0 on); False if it does not fit: not later than the last one, of another size or
        encoding, or a packet that needs one that was not written.
        """
        t_us = round(t_ns / 1000)
        if t_us <= self._last_us:
            return False
        if self._stream is None:
            self._begin(frame)
        if not self._fits(frame):
            return False
        try:
            if frame.encoded is not None and self.how == COPIED:
                for before_ns, earlier in frame.encoded.earlier:
                    self._copy(earlier, round((t_ns - before_ns) / 1000))
                return self._copy(frame.encoded, t_us)
            self._encode(frame, t_us)
        except (av.error.FFmpegError, OSError) as error:
            raise InputError(f"{self.path}: cannot be written ({_reason(error)})") from None
        return True

    def close(self) -> None:
        """Finish the file; safe to call twice."""
        container, self._container = self._container, None
        if container is None:
            return
        try:
            if self.how == ENCODED and self._last_us >= 0:
                container.mux(self._stream.encode(None))
            container.close()
        except (av.error.FFmpegError, OSError) as error:
            raise InputError(f"{self.path}: cannot be finished ({_reason(error)})") from None

    def _begin(self, frame: Frame) -> None:
        self._size_wh, self._number = frame.size_wh, -2
        encoded = frame.encoded
        if encoded is not None and encoded.header:
            self.how, self._codec = COPIED, encoded.codec
            with av.open(io.BytesIO(encoded.header), format="mp4") as template:
                self._stream = self._container.add_stream_from_template(template.streams.video[0], opaque=True)
        else:
            self.how = ENCODED
            self._stream = self._container.add_stream("libx264", rate=30, options=_ENCODING)
            self._stream.width, self._stream.height = frame.size_wh
            self._stream.pix_fmt = "yuv444p" if any(side % 2 for side in frame.size_wh) else "yuv420p"
            self._stream.codec_context.max_b_frames = 0
            self._stream.codec_context.gop_size = _KEYFRAME_EVERY
            self._stream.codec_context.time_base = TIME_BASE
        self._stream.time_base = TIME_BASE

    def _fits(self, frame: Frame) -> bool:
        if frame.size_wh != self._size_wh:
            return False
        if self.how == ENCODED:
            return True
        return frame.encoded is not None and frame.encoded.codec == self._codec

    def _copy(self, encoded: EncodedImage, t_us: int) -> bool:
        # after a packet that was left out, those that build on it are of no use
        if t_us <= self._last_us or not (encoded.keyframe or encoded.number == self._number + 1):
            return False
        packet = av.Packet(encoded.data)
        packet.pts = packet.dts = t_us
        packet.time_base = TIME_BASE
        packet.is_keyframe = encoded.keyframe
        packet.stream = self._stream
        self._container.mux(packet)
        self._last_us, self._number = t_us, encoded.number
        return True

    def _encode(self, frame: Frame, t_us: int) -> None:
        image = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame.image), format="rgb24")
        image.pts, image.time_base = t_us, TIME_BASE
        self._container.mux(self._stream.encode(image))
        self._last_us = t_us


def _reason(error: Exception) -> str:
    """Without the path, which the message names already."""
    return getattr(error, "strerror", None) or str(error)
