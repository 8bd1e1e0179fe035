"""Messages between processes of one machine: whole or not at all, bounded, never waiting unless asked to."""

from __future__ import annotations

import contextlib
import pickle
import select
import socket
import struct
import threading
import time
from collections.abc import Sequence
from typing import Any

from .platform import message_sockets

# what the kernel may hold for a reader; it caps this at its own limit
_BUFFER_BYTES = 1 << 20
_LENGTH = struct.Struct("<I")
_RETRY_S = 0.01


class ChannelClosed(Exception):
    """The other side is gone."""


class Channel:
    """One end of a socket pair that carries whole Python values of any size; a writer killed midway leaves no half message.

    A message counts as handed over once some of it went out; the rest, for which the socket had no room, is kept and goes out
    before anything else when the end is next used. Only the message being received is buffered, so that `select` on the socket
    still shows whether there is another. May be used by several threads.
    """

    def __init__(self, end: socket.socket) -> None:
        end.setblocking(False)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            end.setsockopt(socket.SOL_SOCKET, option, _BUFFER_BYTES)
        self._socket, self._lock = end, threading.Lock()
        self._unsent, self._partial, self._closed = b"", bytearray(), False

    @staticmethod
    def pair() -> tuple[Channel, Channel]:
        """Two ends."""
        one, other = message_sockets()
        return Channel(one), Channel(other)

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    def send(self, value: Any, wait_s: float = 0.0) -> bool:
        """Whether the message could be handed over within `wait_s`; raises ChannelClosed when the other side is gone."""
        raw = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
        until_s = time.monotonic() + wait_s
        with self._lock:
            if self._closed:  # TCP would take one more message before it notices
                raise ChannelClosed
            if not self._flushed(until_s):
                return False
            self._unsent = message = _LENGTH.pack(len(raw)) + raw
            if not self._flushed(until_s) and len(self._unsent) == len(message):
                self._unsent = b""
                return False
            return True

    def receive(self) -> Any | None:
        """The oldest message, or None when there is none now; raises ChannelClosed when no more can come."""
        with self._lock:
            with contextlib.suppress(ChannelClosed):  # no one takes the rest any more, but what was sent to us can still be read
                self._flushed(0.0)
            while (missing := self._missing()) > 0:
                try:
                    chunk = self._socket.recv(missing)
                except BlockingIOError:
                    return None
                except OSError:
                    chunk = b""
                if not chunk:
                    self._closed = True
                    raise ChannelClosed
                self._partial += chunk
            message = bytes(self._partial[_LENGTH.size :])
            self._partial.clear()
        return pickle.loads(message)

    def wait(self, timeout_s: float) -> bool:
        """Wait until something can be received."""
        return bool(select.select([self._socket], [], [], timeout_s)[0])

    def close(self) -> None:
        """Safe to call twice."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _missing(self) -> int:
        """Bytes until the length is known, then until the message is whole."""
        if len(self._partial) < _LENGTH.size:
            return _LENGTH.size - len(self._partial)
        return int(_LENGTH.unpack_from(self._partial)[0]) + _LENGTH.size - len(self._partial)

    def _flushed(self, until_s: float) -> bool:
        """Whether nothing is left to be sent, trying until that monotonic time."""
        while self._unsent:
            try:
                self._unsent = self._unsent[self._socket.send(self._unsent) :]
            except BlockingIOError:
                left_s = until_s - time.monotonic()
                if left_s <= 0:
                    return False
                # Linux calls a local socket writable only when three quarters of its buffer are free: `select` alone would wait
                # for long although there is room for a message
                select.select([], [self._socket], [], min(left_s, _RETRY_S))
            except OSError:
                raise ChannelClosed from None
        return True


def wait_any(channels: Sequence[Channel], timeout_s: float) -> bool:
    """Wait until something can be received from any of them; with no channels, for all of `timeout_s`."""
    if channels:
        return bool(select.select(channels, [], [], timeout_s)[0])
    # Windows refuses to select from nothing
    time.sleep(timeout_s)
    return False
