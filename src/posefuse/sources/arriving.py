"""Frames as a camera or a file delivers them: converted to RGB only when they are used, and the packets they came from."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from typing import Any

import av

from posefuse.core.frames import EncodedFrame, Packet

# codecs whose packets are written to an .mp4 unchanged
_COPIED_CODECS = ("h264", "hevc", "mjpeg", "av1")
# those whose decoder needs its parameters before the first packet
_NEED_PARAMETERS = ("h264", "hevc", "av1")


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
    """Packets that were given to a decoder since its last frame; of a stream without presentation times none."""

    def __init__(self, stream: Any) -> None:
        self._context, self._header = stream.codec_context, header_of(stream)
        # network cameras mark where the units of a packet begin; an .mp4 has the length of each
        self._has_marks = bool(self._header) and (self._context.extradata or b"").startswith(b"\0")
        self._packets: list[Packet] = []
        self._number = 0

    def add(self, packet: Any) -> None:
        """A packet that is decoded next."""
        if packet.size and packet.pts is None:
            self._header = b""
        if packet.size and self._header:
            data = _with_lengths(bytes(packet)) if self._has_marks else bytes(packet)
            self._packets.append(Packet(data=data, keyframe=packet.is_keyframe, stamp_ns=_stamp_ns(packet)))

    def of(self, frame: Any) -> EncodedFrame | None:
        """The frame that came out, with what was given to the decoder before it did."""
        packets, self._packets = tuple(self._packets), []
        number, self._number = self._number, self._number + len(packets)
        if not self._header or frame.pts is None:
            return None
        return EncodedFrame(
            stamp_ns=_stamp_ns(frame),
            packets=packets,
            number=number,
            reorder_depth=self._context.reorder_depth,
            header=self._header,
        )


def _with_lengths(data: bytes) -> bytes:
    """Units of H.264 or HEVC that begin after ``00 00 01``, which does not occur in them, each after its length."""
    return b"".join(len(unit).to_bytes(4, "big") + unit for unit in re.split(rb"\x00\x00+\x01", data)[1:])


def _stamp_ns(timed: Any) -> int:
    stamp_ns: int = round(timed.pts * timed.time_base * 1_000_000_000)
    return stamp_ns


def decoded_with_packets(container: Any, stream: Any, keep_encoded: bool) -> Iterator[tuple[Any, EncodedFrame | None]]:
    """Frames of a stream as they come, with their packets if `keep_encoded`."""
    pending = PendingPackets(stream) if keep_encoded else None
    for packet in container.demux(stream):
        if pending is not None:
            pending.add(packet)
        for frame in packet.decode():
            yield frame, pending.of(frame) if pending is not None else None
