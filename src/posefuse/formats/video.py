"""H.264 videos that carry the true time of every frame: written and read; and decoded frames as RGB images.

A frame is converted in the thread that asks, and only when it asks. One that converts itself (`to_ndarray`) sets up FFmpeg's
scaler each time, with a thread per core. For images of 640 x 480 px that takes four times as much processor time.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from threading import Lock
from typing import Any

import av
import numpy as np
from av.container import OutputContainer
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter
from av.video.stream import VideoStream

from posefuse.core import Closing, InputError
from posefuse.core.arrays import Array
from posefuse.core.frames import Pixels

# their first plane is the brightness
_PLANAR = ("yuv420p", "yuv422p", "yuv444p", "yuvj420p", "yuvj422p", "yuvj444p")


class PixelConverter:
    """Converts the frames of one video."""

    def __init__(self) -> None:
        self._scaler, self._lock = VideoReformatter(), Lock()

    def rgb(self, decoded: VideoFrame) -> Array:
        """(H, W, 3) uint8 RGB."""
        with self._lock:
            return np.asarray(self._scaler.reformat(decoded, format="rgb24", threads=1).to_ndarray())


class DecodedPixels(Pixels):
    """A decoded frame, turned upright as its file asks."""

    def __init__(self, decoded: VideoFrame, converter: PixelConverter) -> None:
        self._decoded, self._converter = decoded, converter
        self._rgb: Array | None = None

    @property
    def size_wh(self) -> tuple[int, int]:
        """See `Pixels`."""
        width, height = self._decoded.width, self._decoded.height
        return (height, width) if round(self._decoded.rotation / 90) % 2 else (width, height)

    def rgb(self) -> Array:
        """See `Pixels`."""
        if self._rgb is None:
            self._rgb = upright(self._converter.rgb(self._decoded), self._decoded)
        return self._rgb

    def brightness(self, step: int) -> Array:
        """See `Pixels`; of the usual formats nothing is converted."""
        if self._decoded.format.name not in _PLANAR:
            return super().brightness(step)
        plane: Any = self._decoded.planes[0]
        # its lines may be longer than the image is wide
        whole = np.ndarray((plane.height, plane.line_size), np.uint8, plane)
        return whole[::step, : plane.width : step].copy()


def upright(image: Array, decoded: VideoFrame) -> Array:
    """The image (H, W, 3) turned by the file's display rotation."""
    turns = round(decoded.rotation / 90) % 4
    return np.ascontiguousarray(np.rot90(image, turns)) if turns else image


TIME_BASE = Fraction(1, 1_000_000)
# the start of a video is stored in the file's own ticks, 1000 per second unless asked otherwise
MP4_OPTIONS = {"movie_timescale": str(TIME_BASE.denominator)}
_KEYFRAME_EVERY = 60


def open_mp4(path: Path, options: dict[str, str]) -> OutputContainer:
    """A new .mp4; raises InputError when it cannot be made."""
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot be written, there is no folder {path.parent}")
    try:
        return av.open(str(path), "w", format="mp4", options=options)
    except (av.error.FFmpegError, OSError) as error:
        raise InputError(f"{path}: cannot be written ({reason(error)})") from None


def h264_stream(
    container: OutputContainer, size_wh: tuple[int, int], rate: Fraction | int, options: dict[str, str]
) -> VideoStream:
    """Its stream of H.264 without frame reordering, times in microseconds; 4:2:0 colour, or 4:4:4 where a side is odd."""
    stream = container.add_stream("libx264", rate=rate, options=options)
    stream.width, stream.height = size_wh
    stream.pix_fmt = "yuv444p" if size_wh[0] % 2 or size_wh[1] % 2 else "yuv420p"
    stream.time_base = stream.codec_context.time_base = TIME_BASE
    stream.codec_context.max_b_frames = 0
    stream.codec_context.gop_size = _KEYFRAME_EVERY
    return stream


def reason(error: Exception) -> str:
    """Without the path, which messages name already."""
    return getattr(error, "strerror", None) or str(error)


class VideoWriter(Closing):
    """Frames to one .mp4 (H.264, no frame reordering), each with its own presentation time to the microsecond.

    4:2:0 colour, or 4:4:4 where a side is odd. Use as a context manager; the file is complete after `close`.

    Args:
        path: where; an existing file is replaced.
        size_wh: (width, height) of every frame in px.
        rate_hz: nominal rate, for players and rate control; times need not follow it.
        crf: x264's constant rate factor, 0 (lossless) to 51.
        preset: x264's name for how hard it works: ``ultrafast`` to ``veryslow``.
        threads: of the encoder; another number makes another file.

    Raises:
        InputError: the file cannot be written, naming it.
    """

    def __init__(
        self, path: Path, size_wh: tuple[int, int], rate_hz: float, crf: int = 23, preset: str = "veryfast", threads: int = 1
    ) -> None:
        self._path, self._size_wh = path, size_wh
        self._last_pts = -1
        container = open_mp4(path, MP4_OPTIONS)
        options = {"crf": str(crf), "preset": preset, "threads": str(threads)}
        self._stream = h264_stream(container, size_wh, Fraction(rate_hz).limit_denominator(1001), options)
        self._container: OutputContainer | None = container
        self._scaler = VideoReformatter()

    def write(self, image: Array, t_ns: int) -> None:
        """Add one RGB uint8 frame (H, W, 3); raises InputError for a wrong size or a time not after the last one's."""
        self.encode(self.converted(image, t_ns))

    def converted(self, image: Array, t_ns: int) -> av.VideoFrame:
        """The first half of `write`, for callers that convert a frame in one thread while another encodes the one before it.

        Frames are converted in their order, by one thread at a time, and each is then given to `encode` in the same order.
        """
        if image.shape != (self._size_wh[1], self._size_wh[0], 3) or image.dtype != np.uint8:
            raise InputError(f"{self._path}: expected RGB uint8 frames of {self._size_wh} px, got {image.dtype} {image.shape}")
        pts = round(t_ns / 1000)
        if pts <= self._last_pts:
            raise InputError(f"{self._path}: expected times from 0 on, each later than {self._last_pts} us, got {pts} us")
        self._last_pts = pts
        # by a scaler of one thread, without a copy: the encoder's own would start a thread for each of its threads
        given = av.VideoFrame.from_numpy_buffer(np.ascontiguousarray(image), format="rgb24")
        frame = self._scaler.reformat(given, format=self._stream.pix_fmt, threads=1)
        frame.pts, frame.time_base = pts, TIME_BASE
        return frame

    def encode(self, frame: av.VideoFrame | None) -> None:
        """The second half of `write`: add a frame that `converted` returned; None adds what the encoder still holds."""
        if self._container is None:
            raise InputError(f"{self._path}: cannot be written, the file is closed")
        try:
            for packet in self._stream.encode(frame):
                self._container.mux(packet)
        except (av.error.FFmpegError, OSError) as error:
            raise InputError(f"{self._path}: cannot be written ({error})") from None

    def close(self) -> None:
        """Finish the file; safe to call twice."""
        if self._container is not None:
            if self._last_pts >= 0:
                self.encode(None)
            self._container.close()
            self._container = None
