"""The packets of a stream in the order of decoding, until the frames in them have been shown and their times are known."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from posefuse.core.encoded import EncodedFrame, Packet

# between the first times of decoding
_STEP_US = 1000
_NEVER_NS = -(2**63)


@dataclass(frozen=True, eq=False, kw_only=True)
class TimedPacket:
    """A packet with the times, in microseconds, when its frame is shown and when a decoder needs it."""

    packet: Packet
    shown_us: int
    decoded_us: int


class PacketQueue:
    """Places packets on a session's clock: at the time of their frame, or by their stamp where they gave no frame.

    It begins with a keyframe, and again after packets that are missing.
    """

    def __init__(self) -> None:
        self._waiting: deque[Packet] = deque()
        # when the frames of those that wait were shown, by stamp; and stamp and time of the newest one
        self._shown_us: dict[int, int] = {}
        self._newest: tuple[int, int] | None = None
        self._next_number: int | None = None
        self._first_stamp_ns = _NEVER_NS
        # the next times of decoding: as many as there are frames that may be shown after one that follows them
        self._decoded_us: list[int] = []
        self._last_decoded_us: int | None = None

    def begins_again(self, frame: EncodedFrame) -> bool:
        """Whether packets before those of this frame are missing."""
        return frame.number != self._next_number

    def add(self, frame: EncodedFrame, t_us: int) -> bool:
        """Add a frame that is shown at `t_us`; False if no keyframe has come since packets were missing: it cannot be decoded."""
        if self.begins_again(frame) and not self._begin(frame.packets):
            return False
        self._next_number = frame.number + len(frame.packets)
        # others follow the first keyframe, but are shown before it and need what is missing
        self._waiting.extend(packet for packet in frame.packets if packet.stamp_ns >= self._first_stamp_ns)
        if frame.stamp_ns < self._first_stamp_ns:
            return False
        if self._last_decoded_us is None and not self._decoded_us:
            self._decoded_us = [t_us - _STEP_US * before for before in range(frame.reorder_depth, 0, -1)]
        # now that it was shown, what comes with an older stamp is of a clock that was set back
        self._first_stamp_ns = _NEVER_NS
        self._shown_us[frame.stamp_ns] = t_us
        self._newest = frame.stamp_ns, t_us
        return True

    def due(self) -> Iterator[TimedPacket]:
        """Those at the head whose times are known."""
        while self._waiting and self._newest is not None and self._waiting[0].stamp_ns <= self._newest[0]:
            yield from self._timed(self._waiting.popleft(), *self._newest)

    def rest(self) -> Iterator[TimedPacket]:
        """At the end: those that frames which were shown need."""
        while self._newest is not None and any(packet.stamp_ns in self._shown_us for packet in self._waiting):
            yield from self._timed(self._waiting.popleft(), *self._newest)

    def _begin(self, packets: Sequence[Packet]) -> bool:
        self._waiting.clear()
        self._shown_us.clear()
        self._newest = self._next_number = None
        first = next((packet for packet in packets if packet.keyframe), None)
        if first is None:
            return False
        self._first_stamp_ns = first.stamp_ns
        return True

    def _timed(self, packet: Packet, newest_ns: int, newest_us: int) -> Iterator[TimedPacket]:
        shown_us = self._shown_us.pop(packet.stamp_ns, newest_us + round((packet.stamp_ns - newest_ns) / 1000))
        decoded_us = heapq.heappushpop(self._decoded_us, shown_us)
        if self._last_decoded_us is None or decoded_us > self._last_decoded_us:
            self._last_decoded_us = decoded_us
            yield TimedPacket(packet=packet, shown_us=shown_us, decoded_us=decoded_us)
