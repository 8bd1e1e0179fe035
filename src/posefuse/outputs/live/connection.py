"""Poses to the Python program that started the session, see `posefuse.live`."""

from __future__ import annotations

from multiprocessing.connection import Client, Connection
from typing import ClassVar

from posefuse.core import LiveHealth, LiveMessage, LiveOutput, LivePose, LiveStart
from posefuse.foundation.settings import settings

POSES = "poses"


@settings
class ConnectionConfig:
    """A connection on this machine; not for users, `posefuse.live` opens it.

    Attributes:
        port: of the loopback address. authkey: hexadecimal.
    """

    port: int
    authkey: str
    takes: ClassVar[tuple[type[LiveMessage], ...]] = (LivePose, LiveHealth)
    keeps_all: ClassVar[bool] = False

    def build(self) -> LiveOutput:
        """Not yet opened."""
        return ConnectionOutput(self)


class ConnectionOutput:
    """Sends every message on; the receiver keeps the newest."""

    name = "python"

    def __init__(self, config: ConnectionConfig) -> None:
        self._config = config
        self.where = f"port {config.port}"
        self._connection: Connection | None = None

    def take(self, message: LiveMessage) -> None:
        """See `LiveOutput`."""
        if isinstance(message, LiveStart):
            self._connection = Client(("127.0.0.1", self._config.port), authkey=bytes.fromhex(self._config.authkey))
            self._connection.send(POSES)
            self._connection.send(message)
        elif self._connection is not None:
            self._connection.send(message)

    def close(self) -> None:
        """See `LiveOutput`."""
        if self._connection is not None:
            self._connection.close()
