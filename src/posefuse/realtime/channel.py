"""Messages between processes of one machine: whole or not at all, bounded, never waiting unless asked to."""

from __future__ import annotations

import contextlib
import pickle
import select
import socket
from typing import Any

# what the kernel may hold for a reader; it caps this at its own limit
_BUFFER_BYTES = 1 << 20
_LONGEST = 1 << 18


class ChannelClosed(Exception):
    """The other side is gone."""


class Channel:
    """One end of a socket pair that keeps message boundaries; a writer killed midway leaves no half message.

    May be handed to a child process while it is started.
    """

    def __init__(self, end: socket.socket) -> None:
        self._socket = end

    @staticmethod
    def pair() -> tuple[Channel, Channel]:
        """Two ends."""
        ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for end in ends:
            end.setblocking(False)
            for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
                end.setsockopt(socket.SOL_SOCKET, option, _BUFFER_BYTES)
        return Channel(ends[0]), Channel(ends[1])

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    def send(self, value: Any, wait_s: float = 0.0) -> bool:
        """Whether the message could be handed over within `wait_s`; raises ChannelClosed when nobody is there."""
        raw = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
        try:
            self._socket.send(raw)
            return True
        except BlockingIOError:
            if wait_s <= 0:
                return False
        except OSError:
            raise ChannelClosed from None
        select.select([], [self._socket], [], wait_s)
        try:
            self._socket.send(raw)
            return True
        except BlockingIOError:
            return False
        except OSError:
            raise ChannelClosed from None

    def receive(self) -> Any | None:
        """The oldest message, or None when there is none now; raises ChannelClosed when no more can come."""
        try:
            raw = self._socket.recv(_LONGEST)
        except BlockingIOError:
            return None
        except OSError:
            raise ChannelClosed from None
        if not raw:
            raise ChannelClosed
        return pickle.loads(raw)

    def wait(self, timeout_s: float) -> bool:
        """Wait until something can be received."""
        return bool(select.select([self._socket], [], [], timeout_s)[0])

    def close(self) -> None:
        """Safe to call twice."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def close_own(self) -> None:
        """Let go of this process's copy of an end that a child process holds."""
        self._socket.close()
