"""One video file as a source, with the presentation times that are written in it, at once or as if its camera were there."""

from __future__ import annotations

import dataclasses
import itertools
import time
from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from posefuse.core import Frame, SourceError
from posefuse.core.arrays import Array
from posefuse.core.frames import EncodedFrame
from posefuse.formats.video import DecodedPixels, PixelConverter

from .arriving import PendingPackets

VIDEO_SUFFIXES = (".mp4", ".mkv", ".mov", ".avi", ".webm", ".m4v", ".mpg", ".mpeg", ".ts", ".mts", ".m2ts")

# these start at an arbitrary time (a broadcast clock), so only times since the first frame mean anything
_ARBITRARY_START = ("mpegts", "avi", "mpeg")
_MOST_BROKEN_IN_A_ROW = 30
_FIRST_YEAR = 2000
# FFmpeg also opens playlists and descriptions in XML, which name other files, and damaged ones of which crash it
_CONTAINERS = "mov,mp4,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,h264,hevc"
# PyAV 18 refuses metadata that is not UTF-8 unless it is asked to replace it; 19 always does, and has lost the argument
_TOLERANT: dict[str, Any] = {"metadata_errors": "replace"} if int(av.__version__.partition(".")[0]) < 19 else {}


DecodedFrames = Iterator[tuple[VideoFrame, EncodedFrame | None]]


@dataclass(frozen=True)
class VideoConfig:
    """A video file of one camera.

    Attributes:
        path: the file.
        camera: name of the camera in the rig.
        offset_s: added to the file's times; positive when this file began later than the session clock.
        drift_ppm: added per million of the file's times: positive when its clock runs slow.
        keep_encoded: give every frame in the file's own encoding too; none of a file whose packets are not in the order of time.
        threads: decode several frames at once, where there are cores for it; costs more processor time, and delays frames.
    """

    path: Path
    camera: str
    offset_s: float = 0.0
    drift_ppm: float = 0.0
    keep_encoded: bool = False
    threads: bool = True

    @property
    def where(self) -> str:
        """File and camera, for messages."""
        return f"{self.path}: camera {self.camera}"

    def build(self) -> VideoSource:
        """Open the file and look at its first frame; raises SourceError when that cannot be done."""
        return VideoSource(self)


def recorded_at(path: Path) -> str | None:
    """When a video was recorded, in UTC as ``2026-03-01T09:30:00Z``, if its camera wrote that into the file."""
    try:
        with _opened(path) as container:
            stated = container.metadata.get("creation_time", "")
        when = datetime.fromisoformat(stated).astimezone(UTC)
    except (av.error.FFmpegError, OSError, ValueError):
        return None
    # cameras whose clock was never set write the first second of their calendar
    return when.strftime("%Y-%m-%dT%H:%M:%SZ") if when.year >= _FIRST_YEAR else None


class VideoSource:
    """Frames of a video file with true presentation times (variable frame rate is kept as it is).

    Times are those written in the file; containers whose clock starts anywhere (MPEG-TS, AVI) count from their first
    frame. A turned phone video is turned upright as the file asks, and what was cut off without encoding again stays hidden.
    """

    def __init__(self, config: VideoConfig) -> None:
        self._config = config
        self.camera = config.camera
        self._start_ticks: int | None = None
        first = next(self._decode(), None)
        if first is None:
            raise SourceError(f"{config.where}: no frame can be decoded; is the file complete?")
        # one that cannot be converted shows now
        self.size_wh = first.converted().size_wh

    @property
    def stated_frames(self) -> int:
        """By the file's header, more than `times_ns` where its end is missing; 0 where it states none."""
        return self._listed.stated

    def times_ns(self) -> Array:
        """(F,) int64 session times of all frames the file lists, without decoding them."""
        return self._listed.times_ns(self._config)

    def frames(self) -> Iterator[Frame]:
        """Frames in time order from the start; a frame that cannot be decoded is left out."""
        return self._frames(None)

    def frames_from(self, begin_ns: int) -> Iterator[Frame]:
        """See `RecordedSource`; decoded from a key frame shortly before, where the file has an index."""
        return (frame for frame in self._frames(self._key_before(begin_ns)) if frame.t_ns >= begin_ns)

    def _frames(self, key: int | None) -> Iterator[Frame]:
        """From this key frame on; None: from the start."""
        last_ns: int | None = None
        for frame in self._decode(key):
            if (size_wh := frame.size_wh) != self.size_wh:
                raise SourceError(f"{self._config.where}: frame {frame.seq} is {size_wh}, the first was {self.size_wh} px")
            if last_ns is None or frame.t_ns > last_ns:
                last_ns = frame.t_ns
                yield frame

    def close(self) -> None:
        """Nothing stays open between calls of `frames`."""

    @cached_property
    def _listed(self) -> ListedFrames:
        with opened_video(self._config) as container:
            return listed_frames(container)

    def _key_before(self, begin_ns: int) -> int | None:
        """The last key frame, in ticks, from which all frames from a time on may be decoded; None: only from the start."""
        listed, keys = self._listed, [*self._listed.keys]
        start = (self._start_ticks or 0) if listed.starts_anywhere else 0
        count = bisect_right(keys, begin_ns, key=lambda key: session_ns(self._config, (key - start) * listed.base_s))
        return keys[count - 1] if count and listed.timed else None

    def _decode(self, key: int | None = None) -> Iterator[Frame]:
        """Frames from the start, or from this key frame on."""
        with opened_video(self._config) as container:
            stream = container.streams.video[0]
            # with threads for slices alone FFmpeg starts one per core, too, and hands the work round
            stream.thread_type = "AUTO" if self._config.threads else "NONE"
            stream_base, converter, seq = Fraction(stream.time_base or 1), PixelConverter(), -1
            frames = self._decoded_frames(container, stream) if key is None else self._reached(container, stream, key)
            for decoded, encoded in frames or ():
                if decoded.pts is None:
                    continue
                if self._start_ticks is None:
                    self._start_ticks = decoded.pts
                seq = bisect_left(self._listed.ticks, decoded.pts) if seq < 0 and key is not None else seq + 1
                start_ticks = self._start_ticks if container.format.name in _ARBITRARY_START else 0
                t_ns = ticks_ns(self._config, decoded.pts - start_ticks, decoded.time_base or stream_base)
                pixels = DecodedPixels(decoded, converter)
                yield Frame(camera=self.camera, seq=seq, t_ns=t_ns, received_ns=t_ns, image=pixels, encoded=encoded)
        if frames is None:
            yield from self._decode()

    def _reached(self, container: av.container.InputContainer, stream: VideoStream, key: int) -> DecodedFrames | None:
        """All frames from a key frame on, decoded as from the start; None where the file does not lead there."""
        container.seek(self._listed.keys[key], stream=stream)
        frames = self._decoded_frames(container, stream)
        # a file without an index may lead anywhere, and with intra refresh the marked frame is not decoded
        with suppress(SourceError):
            for frame, encoded in frames:
                if frame.pts is None or frame.pts >= key:
                    return itertools.chain([(frame, encoded)], frames) if frame.pts == key else None
        return None

    def _decoded_frames(self, container: av.container.InputContainer, stream: VideoStream) -> DecodedFrames:
        """Decode packet by packet, so that a broken one costs only itself."""
        in_a_row = 0
        pending = PendingPackets(stream) if self._config.keep_encoded else None
        packets = container.demux(stream)
        while True:
            try:
                packet = next(packets)
                if pending is not None:
                    pending.add(packet)
                decoded = packet.decode()
            except StopIteration:
                return
            except av.error.FFmpegError as error:
                in_a_row += 1
                if in_a_row > _MOST_BROKEN_IN_A_ROW:
                    raise SourceError(f"{self._config.where}: {in_a_row} broken packets in a row ({error.strerror})") from None
                continue
            if decoded:
                in_a_row = 0
            for frame in decoded:
                if not frame.is_corrupt:
                    yield frame, pending.of(frame) if pending is not None else None


def session_ns(config: VideoConfig, file_time_s: Fraction) -> int:
    """Session time of a time of the file."""
    return ticks_ns(config, file_time_s.numerator, Fraction(1, file_time_s.denominator))


def ticks_ns(config: VideoConfig, ticks: int, base_s: Fraction) -> int:
    """Session time of so many ticks of `base_s` in the file."""
    # whole numbers: fractions would take a tenth as long as decoding the frame
    count, per_s = ticks * base_s.numerator, base_s.denominator
    whole, rest = divmod(count * 1_000_000_000, per_s)
    # halves to the even side, as `round` does
    whole += 2 * rest > per_s or (2 * rest == per_s and whole % 2)
    return whole + round(config.offset_s * 1e9 + count / per_s * config.drift_ppm * 1e3)


def _opened(path: Path) -> av.container.InputContainer:
    container: av.container.InputContainer = av.open(str(path), container_options={"format_whitelist": _CONTAINERS}, **_TOLERANT)
    return container


def opened_video(config: VideoConfig) -> av.container.InputContainer:
    """The file, with a video stream that can be decoded; raises SourceError that names the defect."""
    where = config.where
    if not Path(config.path).is_file():
        raise SourceError(f"{where}: no such video file")
    try:
        container = _opened(config.path)
    except (av.error.FFmpegError, OSError) as error:
        reason = error.strerror or type(error).__name__
        raise SourceError(f"{where}: not a video that can be opened ({reason}); is the file complete?") from None
    if not container.streams.video:
        container.close()
        raise SourceError(f"{where}: the file holds no video stream")
    context: object = container.streams.video[0].codec_context  # None where it cannot be decoded, which the stubs leave out
    if context is None:
        # PyAV crashes when it decodes such a stream
        container.close()
        raise SourceError(f"{where}: its video is in a format that cannot be decoded; is the file damaged?")
    return container


def length_s(path: Path) -> float:
    """As the file states it, 0 where it does not; raises SourceError for one that cannot be opened."""
    with opened_video(VideoConfig(path, path.stem)) as container:
        return container.duration / av.time_base if container.duration else 0.0


class ListedFrames(NamedTuple):
    """What a file lists, in ticks of `base_s`, sorted: times of frames, and when key frames are decoded by their times.

    Frames that an edit list hides are not listed; hidden key frames are, because those after them are decoded from there.
    `stated`: how many frames the header states, without hidden ones. `timed`: whether each packet has a time.
    `starts_anywhere`: whether only times since the first frame mean anything.
    """

    ticks: list[int]
    keys: dict[int, int]
    stated: int
    timed: bool
    base_s: Fraction
    starts_anywhere: bool

    def times_ns(self, config: VideoConfig) -> Array:
        """(F,) int64 session times of the frames; raises SourceError for times that no recording has."""
        start = self.ticks[0] if self.ticks and self.starts_anywhere else 0
        times_s = [(tick - start) * self.base_s for tick in self.ticks]
        try:
            return np.array([session_ns(config, time_s) for time_s in times_s], dtype=np.int64)
        except OverflowError:
            raise SourceError(f"{config.where}: times up to {float(times_s[-1]):.3g} s; the file is damaged") from None


def listed_frames(container: av.container.InputContainer) -> ListedFrames:
    """What the packets of a file list, up to the first that cannot be read."""
    stream = container.streams.video[0]
    ticks: set[int] = set()
    keys: dict[int, int] = {}
    stated, timed = stream.frames, True
    with suppress(av.error.FFmpegError):
        for packet in container.demux(stream):
            stated -= packet.is_discard
            if packet.pts is not None:
                ticks.update([] if packet.is_discard else [packet.pts])
                keys.update({packet.pts: packet.dts} if packet.is_keyframe and packet.dts is not None else {})
            timed = timed and (packet.pts is not None or not packet.size)
    base_s, anywhere = Fraction(stream.time_base or 1), container.format.name in _ARBITRARY_START
    return ListedFrames(sorted(ticks), dict(sorted(keys.items())), max(stated, 0), timed, base_s, anywhere)


# one that begins so much after its zero has missed frames; before, it shows all
_LATE_NS = 1_000_000_000


@dataclass(frozen=True)
class PacedVideoConfig:
    """A video file at wall-clock pace.

    Attributes:
        path: the file. camera: name of the camera in the rig.
        zero_ns: monotonic time at which the file shows its time 0, so that several cameras agree; None is when the first
            frame is asked for.
        keep_encoded: give every frame in the file's own encoding too.
    """

    path: Path
    camera: str
    zero_ns: int | None = None
    keep_encoded: bool = False

    def build(self) -> PacedVideoSource:
        """Open the file and look at its first frame; raises SourceError when that cannot be done."""
        return PacedVideoSource(self)


class PacedVideoSource:
    """Frames of a video file at their times; a computer that is too slow for the file gives them late."""

    def __init__(self, config: PacedVideoConfig) -> None:
        self._config = config
        self.camera = config.camera
        self._video: VideoSource = VideoConfig(
            config.path, config.camera, keep_encoded=config.keep_encoded, threads=False
        ).build()
        self.size_wh = self._video.size_wh

    def frames(self) -> Iterator[Frame]:
        """Frames in time order; `received_ns` is when a frame was handed on, on the file's own clock."""
        zero_ns = self._config.zero_ns if self._config.zero_ns is not None else time.monotonic_ns()
        late_ns = time.monotonic_ns() - zero_ns
        # a process that was started again continues where the others are
        for frame in self._video.frames_from(late_ns) if late_ns > _LATE_NS else self._video.frames():
            time.sleep(max(0, zero_ns + frame.t_ns - time.monotonic_ns()) / 1e9)
            yield dataclasses.replace(frame, image=frame.pixels, received_ns=time.monotonic_ns() - zero_ns)

    def close(self) -> None:
        """Nothing stays open between calls of `frames`."""
        self._video.close()
