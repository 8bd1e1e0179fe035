"""An image as its camera encoded it, to store videos without encoding them again."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, eq=False, kw_only=True)
class EncodedImage:
    """The bytes of one frame in the camera's own encoding; frames come in the order of their times.

    Attributes:
        codec: its name in FFmpeg, e.g. ``h264``. data: one packet.
        keyframe: can be decoded alone. number: counts the packets of the stream; others than keyframes need the one before.
        earlier: (ns before this frame, packet) of frames that were left out since the last one, oldest first.
        header: an .mp4 without frames that has the stream's parameters; empty where an .mp4 does not take such packets.
    """

    codec: str
    data: bytes
    keyframe: bool
    number: int
    header: bytes
    earlier: tuple[tuple[int, EncodedImage], ...] = ()
