"""Whole messages over the byte stream of a socket."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time

_LENGTH = struct.Struct("<I")
_RETRY_S = 0.01


class Framing:
    """Length and bytes; half a message is never given out, and a message may have any size.

    A message counts as handed over once some of it went out; the rest, for which the socket had no room, is kept and goes out
    before anything else when the end is next used. Only the message being received is buffered, so that `select` on
    the socket still shows whether there is another.
    """

    def __init__(self) -> None:
        self._unsent = b""
        self._partial = bytearray()
        self._closed = False

    def send(self, end: socket.socket, raw: bytes, wait_s: float) -> bool:
        """Whether the message was handed over; within `wait_s` it waits for room for all of it.

        Raises OSError when the other end is closed.
        """
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
        """The oldest message, None when there is none now, empty when the other end is closed."""
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
