"""An image as its camera encoded it, for who keeps videos without encoding them again."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, eq=False, kw_only=True)
class EncodedImage:
    """The bytes of one frame in the camera's own encoding; frames come in the order of their times.

    Attributes:
        codec: its name in FFmpeg, e.g. ``h264``. data: one packet.
        keyframe: can be decoded alone. number: counts the packets of the stream; others than keyframes need the one before.
        earlier: (ns before this frame, packet) of frames that were left out since the last one, oldest first.
        stream: PyAV's description of the stream it came from, of this process only.
    """

    codec: str
    data: bytes
    keyframe: bool
    number: int
    stream: Any = field(repr=False)
    earlier: tuple[tuple[int, EncodedImage], ...] = ()
