"""Datagrams to one or many listeners over UDP."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from types import TracebackType

from posefuse.core import ConfigError


class UdpStream:
    """Sends datagrams to fixed addresses; never waits, and continues when a listener or the network is away.

    Attributes:
        sent, lost: datagrams handed to, and not taken by, the network.
        last_fault: why the newest lost one was not taken.

    Raises:
        ConfigError: an address that is not ``host:port``, or a host that is not known.
    """

    def __init__(self, addresses: Sequence[str]) -> None:
        self.sent, self.lost, self.last_fault = 0, 0, ""
        self._targets = [_resolved(address) for address in addresses]
        self._sockets: dict[int, socket.socket] = {}
        for family, _ in self._targets:
            if family not in self._sockets:
                self._sockets[family] = socket.socket(family, socket.SOCK_DGRAM)
                self._sockets[family].setblocking(False)

    def send(self, datagrams: Sequence[bytes]) -> None:
        """Send each datagram to every address."""
        for family, target in self._targets:
            for datagram in datagrams:
                try:
                    self._sockets[family].sendto(datagram, target)
                    self.sent += 1
                except OSError as error:
                    self.lost += 1
                    self.last_fault = str(error)

    def close(self) -> None:
        """Safe to call twice."""
        for opened in self._sockets.values():
            opened.close()

    def __enter__(self) -> UdpStream:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def _resolved(address: str) -> tuple[int, tuple[object, ...]]:
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise ConfigError(f"UDP address: expected host:port with a port of 1 to 65535, got {address!r}")
    try:
        family, _, _, _, target = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)[0]
    except OSError as error:
        raise ConfigError(f"UDP address {address!r}: the host is not known ({error})") from None
    return family, target
