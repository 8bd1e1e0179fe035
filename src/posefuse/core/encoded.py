"""An image as its camera encoded it, to store videos without encoding them again."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, eq=False, kw_only=True)
class Packet:
    """The bytes of one frame, as the stream carries them.

    Attributes:
        data: what a decoder takes. keyframe: can be decoded alone. stamp_ns: presentation time on the stream's own clock.
    """

    data: bytes
    keyframe: bool
    stamp_ns: int


@dataclass(frozen=True, eq=False, kw_only=True)
class EncodedFrame:
    """One frame in the camera's own encoding; frames come in the order of their times, packets in that of decoding.

    Attributes:
        codec: its name in FFmpeg, e.g. ``h264``. stamp_ns: presentation time on the stream's own clock.
        packets: all that the decoder was given since the frame before; the frame's own is among these or earlier ones.
        number: how many packets the stream had before these: where some are missing, the next ones cannot be decoded.
        reorder_depth: most packets that precede another one and are shown after it; 0 where the orders are the same.
        earlier: (ns before this frame, frame) of those that were left out since the last one, oldest first.
        header: an .mp4 without frames that has the stream's parameters.
    """

    codec: str
    stamp_ns: int
    packets: tuple[Packet, ...]
    number: int
    reorder_depth: int
    header: bytes
    earlier: tuple[tuple[int, EncodedFrame], ...] = ()
