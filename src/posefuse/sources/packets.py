"""The packets that decoded frames came from."""

from __future__ import annotations

import io
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import av

from posefuse.core.encoded import EncodedImage

from .arriving import Arrived

# codecs whose packets are written to an .mp4 unchanged
_COPIED_CODECS = ("h264", "hevc", "mjpeg", "av1", "mpeg4")
# those whose decoder needs its parameters before the first packet
_NEED_PARAMETERS = ("h264", "hevc", "av1")
# a decoder that holds back more packets than this reorders them
_MOST_PENDING = 32


def header_of(stream: Any) -> bytes:
    """The stream's parameters as an .mp4 without frames; empty where its packets cannot go to one as they are."""
    codec = stream.codec_context.name
    if codec not in _COPIED_CODECS or (codec in _NEED_PARAMETERS and not stream.codec_context.extradata):
        return b""
    made = io.BytesIO()
    try:
        with av.open(made, "w", format="mp4", options={"movflags": "empty_moov+default_base_moof"}) as container:
            container.add_stream_from_template(stream, opaque=True)
            container.start_encoding()
    except (av.error.FFmpegError, ValueError):
        return b""
    return made.getvalue()


class PendingPackets:
    """Packets that were given to a decoder, until their frame comes out; only of streams without reordering."""

    def __init__(self, stream: Any) -> None:
        self._codec, self._header = stream.codec_context.name, header_of(stream)
        self._packets: deque[tuple[int | None, EncodedImage]] = deque()
        self._reordered, self._count = False, 0

    def add(self, packet: Any) -> None:
        """A packet that is decoded next."""
        if packet.size and self._header and not self._reordered:
            encoded = EncodedImage(
                codec=self._codec, data=bytes(packet), keyframe=packet.is_keyframe, number=self._count, header=self._header
            )
            self._count += 1
            self._packets.append((packet.pts, encoded))
            self._reordered = len(self._packets) > _MOST_PENDING

    def of(self, frame: Any) -> EncodedImage | None:
        """The packet of the frame that came out; packets before it gave none. None where packets are not in order of time."""
        if not self._header:
            return None
        if self._reordered or all(pts != frame.pts for pts, _ in self._packets):
            self._packets.clear()
            self._reordered = True
            return None
        while self._packets:
            pts, encoded = self._packets.popleft()
            if pts == frame.pts:
                return encoded
        return None


def with_earlier(frame: Arrived, left_out: Sequence[Arrived]) -> EncodedImage | None:
    """The frame's packet, with those of frames that were left out since the last one."""
    if frame.encoded is None:
        return None
    earlier = tuple((frame.t_ns - one.t_ns, one.encoded) for one in left_out if one.encoded is not None)
    return replace(frame.encoded, earlier=earlier)


def decoded_with_packets(container: Any, stream: Any, keep_encoded: bool) -> Iterator[tuple[Any, EncodedImage | None]]:
    """Frames of a stream as they come, with their packets if `keep_encoded`."""
    pending = PendingPackets(stream) if keep_encoded else None
    for packet in container.demux(stream):
        if pending is not None:
            pending.add(packet)
        for frame in packet.decode():
            yield frame, pending.of(frame) if pending is not None else None
