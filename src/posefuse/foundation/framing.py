"""Whole messages over sockets: as packets where the system keeps their boundaries, else as a stream of length and bytes."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time

_LENGTH = struct.Struct("<I")
# the longest packet that is read
_LONGEST = 1 << 18
_RETRY_S = 0.01


class PacketFraming:
    """For sockets that keep message boundaries: a writer killed midway leaves no half message."""

    def __init__(self) -> None:
        # made when it is needed, as either end may go to another process
        self._room = bytearray()

    def send(self, end: socket.socket, raw: bytes, wait_s: float) -> bool:
        """Whether the message was handed over within `wait_s`; raises OSError when the other end is closed."""
        until_s = time.monotonic() + wait_s
        while True:
            try:
                end.send(raw)
                return True
            except BlockingIOError:
                if not _waited(end, until_s):
                    return False

    def receive(self, end: socket.socket) -> bytes | None:
        """The oldest message, None when there is none now, empty when the other end is closed."""
        # one buffer for all: memory for the longest packet takes longer to get than a packet to read
        self._room = self._room or bytearray(_LONGEST)
        try:
            return bytes(memoryview(self._room)[: end.recv_into(self._room)])
        except BlockingIOError:
            return None


class StreamFraming:
    """For byte streams; half a message is never given out.

    A message counts as handed over once some of it went out; the rest, for which the socket had no room, is kept and goes out
    before anything else when the end is next used. Only the message being received is buffered, so that `select` on
    the socket still shows whether there is another.
    """

    def __init__(self) -> None:
        self._unsent = b""
        self._partial = bytearray()
        self._closed = False

    def send(self, end: socket.socket, raw: bytes, wait_s: float) -> bool:
        """As `PacketFraming.send`; within `wait_s` it waits for room for the whole message."""
        if self._closed:  # TCP would take one more message before it notices
            raise BrokenPipeError
        until_s = time.monotonic() + wait_s
        if not self._flushed(end, until_s):
            return False
        self._unsent = message = _LENGTH.pack(len(raw)) + raw
        if not self._flushed(end, until_s) and len(self._unsent) == len(message):
            self._unsent = b""
            return False
        return True

    def receive(self, end: socket.socket) -> bytes | None:
        """As `PacketFraming.receive`."""
        with contextlib.suppress(OSError):  # no one takes the rest any more, but what was sent to us can still be read
            self._flushed(end, 0.0)
        try:
            while (missing := self._missing()) > 0:
                chunk = end.recv(missing)
                if not chunk:
                    self._closed = True
                    return b""
                self._partial += chunk
        except BlockingIOError:
            return None
        message = bytes(self._partial[_LENGTH.size :])
        self._partial.clear()
        return message

    def _missing(self) -> int:
        """Bytes until the length is known, then until the message is whole."""
        if len(self._partial) < _LENGTH.size:
            return _LENGTH.size - len(self._partial)
        [length] = _LENGTH.unpack_from(self._partial)
        return int(length) + _LENGTH.size - len(self._partial)

    def _flushed(self, end: socket.socket, until_s: float) -> bool:
        """Whether nothing is left to be sent, trying until that monotonic time."""
        while self._unsent:
            try:
                self._unsent = self._unsent[end.send(self._unsent) :]
            except BlockingIOError:
                if not _waited(end, until_s):
                    return False
        return True


def _waited(end: socket.socket, until_s: float) -> bool:
    """Wait for room, for a moment at most; False when the time is over.

    Linux calls a local socket writable only when three quarters of its buffer are free, so `select` alone would wait for long
    although there is room for a message.
    """
    left_s = until_s - time.monotonic()
    if left_s <= 0:
        return False
    select.select([], [end], [], min(left_s, _RETRY_S))
    return True
