"""USB cameras (V4L2, AVFoundation, DirectShow) and network cameras (RTSP, HTTP), through the libraries PyAV brings.

A stream's own time stamps are even but start anywhere; arrival is late by a delay that varies. The stamps are placed so
that the frame with the least delay arrives exactly at its stamp: an offset that is the least of (arrival - stamp) over the
newest seconds, so that a clock that drifts is followed.
"""

from __future__ import annotations

import errno
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import av

from posefuse.core import Frame, SourceError
from posefuse.core.errors import choices
from posefuse.formats.video import DecodedPixels, PixelConverter
from posefuse.foundation.platform import usb_camera_address, usb_camera_format, usb_cameras
from posefuse.sources.arriving import decoded_with_packets

_FOLLOW_NS = 10_000_000_000
# videos have times in microseconds
_LEAST_STEP_NS = 1_000
_OPEN_S, _READ_S = 8.0, 5.0
# a camera that is closed is waited for so long: most have sent their next image by then
_LEAVE_S = 0.25
_ADVICE = {
    errno.EBUSY: "another program uses it",
    errno.ENOTTY: "it is no camera",
    errno.EINVAL: "does it offer the size and rate asked for?",
}


@dataclass(frozen=True, kw_only=True)
class StreamConfig:
    """One live camera.

    Attributes:
        where: ``rtsp://...``, ``http://...``, or a USB camera: ``/dev/video0`` on Linux, its number or name on macOS, its
            name on Windows.
        camera: name of the camera in the rig.
        size: ``WIDTHxHEIGHT`` or ``WIDTHxHEIGHT@RATE`` to ask a USB camera for; empty takes its own choice.
        keep_encoded: give every frame in the camera's own encoding too.
        open_s: how long connecting may take. read_s: a stream that sends nothing for so long is lost.
    """

    where: str
    camera: str
    size: str = ""
    keep_encoded: bool = False
    open_s: float = _OPEN_S
    read_s: float = _READ_S

    def build(self) -> StreamSource:
        """Connect and wait for the first image; raises SourceError that lists what is there."""
        return StreamSource(self)


class StreamSource:
    """Frames of a live camera in RGB; times are Unix epoch by the machine's clock, mid-exposure as far as it is known."""

    def __init__(self, config: StreamConfig) -> None:
        self._config = config
        self.camera = config.camera
        self._container: Any = _connected(config)
        self._reading, self._closed = threading.Lock(), False
        self._decoded = decoded_with_packets(self._container, self._container.streams.video[0], config.keep_encoded)
        self._converter = PixelConverter()
        self._times = StampClock()
        self._seq = 0
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._first: Frame | None = self._next()
        # one that cannot be converted shows now
        self.size_wh = self._first.converted().size_wh

    def frames(self) -> Iterator[Frame]:
        """Frames as they come; raises SourceError when they stop coming or change size."""
        if self._first is not None:
            first, self._first = self._first, None
            yield first
        while True:
            with self._reading:
                if self._container is None:
                    return
                try:
                    frame = self._next()
                finally:
                    if self._closed:
                        self._disconnect()
            if (size_wh := frame.size_wh) != self.size_wh:
                raise SourceError(f"{self._where}: frames were {self.size_wh}, now {size_wh} px")
            yield frame

    def close(self) -> None:
        """Disconnect; safe to call twice.

        A thread that waits for an image disconnects when that has come: what is freed while FFmpeg reads it ends the program.
        """
        self._closed = True
        if self._reading.acquire(timeout=_LEAVE_S):
            self._disconnect()
            self._reading.release()

    def _disconnect(self) -> None:
        container, self._container = self._container, None
        if container is not None:
            container.close()

    @property
    def _where(self) -> str:
        return f"{self._config.where}: camera {self.camera}"

    def _next(self) -> Frame:
        try:
            decoded, encoded = next(self._decoded)
        except StopIteration:
            raise SourceError(f"{self._where}: the stream has ended") from None
        except av.error.ExitError:
            raise SourceError(f"{self._where}: no image for {self._config.read_s:g} s") from None
        except (av.error.FFmpegError, OSError) as error:
            raise SourceError(f"{self._where}: no image any more ({getattr(error, 'strerror', None) or error})") from None
        now_ns = time.monotonic_ns() + self._epoch_ns
        stamp_ns = None if decoded.pts is None else round(decoded.pts * decoded.time_base * 1_000_000_000)
        t_ns = self._times.placed(stamp_ns, now_ns)
        self._seq += 1
        return Frame(
            camera=self.camera,
            seq=self._seq - 1,
            t_ns=t_ns,
            received_ns=now_ns,
            image=DecodedPixels(decoded, self._converter),
            encoded=encoded,
        )


class StampClock:
    """Places a stream's stamps on the clock of arrival."""

    def __init__(self) -> None:
        self._offsets: deque[tuple[int, int]] = deque()
        self._newest_ns: int | None = None
        self._stamp_ns = 0

    def placed(self, stamp_ns: int | None, arrived_ns: int) -> int:
        """Time of the image: stamp plus least offset; arrival where there is no stamp. Increasing."""
        if stamp_ns is not None:
            if stamp_ns < self._stamp_ns:
                # the camera has set its clock back: offsets from before mean nothing
                self._offsets.clear()
            self._stamp_ns = stamp_ns
        t_ns = arrived_ns if stamp_ns is None else stamp_ns + self._offset(arrived_ns - stamp_ns, stamp_ns)
        if self._newest_ns is not None:
            t_ns = max(t_ns, self._newest_ns + _LEAST_STEP_NS)
        self._newest_ns = t_ns
        return t_ns

    def _offset(self, offset_ns: int, stamp_ns: int) -> int:
        # a queue of increasing offsets: its head is the least within the window, which counts by stamps: images that waited in
        # the network come all at once
        while self._offsets and self._offsets[-1][1] >= offset_ns:
            self._offsets.pop()
        self._offsets.append((stamp_ns, offset_ns))
        while self._offsets[0][0] < stamp_ns - _FOLLOW_NS:
            self._offsets.popleft()
        return self._offsets[0][1]


def _connected(config: StreamConfig) -> Any:
    where = f"{config.where}: camera {config.camera}"
    device = "://" not in config.where
    size, _, rate = config.size.partition("@")
    options = {"fflags": "nobuffer", "flags": "low_delay"}
    if config.where.startswith("rtsp"):
        options["rtsp_transport"] = "tcp"
    options |= ({"video_size": size} if size else {}) | ({"framerate": rate} if rate else {})
    begun_s = time.monotonic()
    try:
        container: Any = av.open(
            usb_camera_address(config.where) if device else config.where,
            format=usb_camera_format() if device else None,
            options=options,
            timeout=(config.open_s, config.read_s),
        )
    except PermissionError:
        raise SourceError(f"{where}: no permission to read it; add yourself to its group (usually: video)") from None
    except (av.error.FFmpegError, OSError) as error:
        # the library ends at its time limit with errors that name all sorts of causes
        if isinstance(error, av.error.ExitError) or time.monotonic() - begun_s >= config.open_s:
            advice = "is it switched on, and do address, port and path name a stream?"
            raise SourceError(f"{where}: no answer within {config.open_s:g} s; {advice}") from None
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        advice = _advice(getattr(error, "errno", None) or 0) if device else "is it switched on, and the address right?"
        raise SourceError(f"{where}: cannot be opened ({reason}); {advice}") from None
    if not container.streams.video:
        container.close()
        raise SourceError(f"{where}: carries no video")
    container.streams.video[0].thread_type = "SLICE"
    return container


def _advice(code: int) -> str:
    if code in _ADVICE:
        return _ADVICE[code]
    return f"there are: {choices(list(usb_cameras()))}; is it switched on, and the address right?"
