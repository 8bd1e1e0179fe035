"""Messages between processes of one machine: whole or not at all, bounded, never waiting unless asked to."""

from __future__ import annotations

import contextlib
import pickle
import select
import socket
import time
from collections.abc import Sequence
from typing import Any

from .framing import Framing
from .platform import message_sockets

# what the kernel may hold for a reader; it caps this at its own limit
_BUFFER_BYTES = 1 << 20


class ChannelClosed(Exception):
    """The other side is gone."""


class Channel:
    """One end of a socket pair that carries whole messages; a writer killed midway leaves no half message.

    May be handed to a child process while it is started.
    """

    def __init__(self, end: socket.socket) -> None:
        self._socket, self._framing = end, Framing()

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        # Windows does not carry this over to the process that gets the socket
        self._socket.setblocking(False)

    @staticmethod
    def pair() -> tuple[Channel, Channel]:
        """Two ends."""
        ends = message_sockets()
        for end in ends:
            end.setblocking(False)
            for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
                end.setsockopt(socket.SOL_SOCKET, option, _BUFFER_BYTES)
        return Channel(ends[0]), Channel(ends[1])

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    def send(self, value: Any, wait_s: float = 0.0) -> bool:
        """Whether the message could be handed over within `wait_s`; raises ChannelClosed when the other side is gone."""
        raw = pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
        try:
            return self._framing.send(self._socket, raw, wait_s)
        except OSError:
            raise ChannelClosed from None

    def receive(self) -> Any | None:
        """The oldest message, or None when there is none now; raises ChannelClosed when no more can come."""
        try:
            raw = self._framing.receive(self._socket)
        except OSError:
            raise ChannelClosed from None
        if raw is None:
            return None
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
        """Close this process's copy of an end that a child process holds."""
        self._socket.close()


def wait_any(channels: Sequence[Channel], timeout_s: float) -> bool:
    """Wait until something can be received from any of them; with no channels, for all of `timeout_s`."""
    if channels:
        return bool(select.select(channels, [], [], timeout_s)[0])
    # Windows refuses to select from nothing
    time.sleep(timeout_s)
    return False
