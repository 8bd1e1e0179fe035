"""Poses to the Python program that started the session, see `posefuse.live`."""

from __future__ import annotations

from multiprocessing.connection import Client, Connection
from typing import ClassVar

from posefuse.core import LiveDetections, LiveHealth, LiveMessage, LiveOutput, LivePose, LivePreview, LiveStart
from posefuse.foundation.settings import settings

POSES = "poses"
_TAKES = (LivePose, LiveHealth)


@settings
class ConnectionConfig:
    """A connection on this machine; not for users, `posefuse.live` opens it.

    Attributes:
        port: of the loopback address. authkey: hexadecimal.
        images: send the cameras' small images, too, each after the detections in it.
    """

    port: int
    authkey: str
    images: bool = False
    takes: ClassVar[tuple[type[LiveMessage], ...]] = _TAKES
    keeps_all: ClassVar[bool] = False

    def __post_init__(self) -> None:
        # an instance may accept more than its class states
        object.__setattr__(self, "takes", (*_TAKES, LiveDetections, LivePreview) if self.images else _TAKES)

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
        # detections of frames without an image stay here
        self._views: dict[str, LiveDetections] = {}

    def take(self, message: LiveMessage) -> None:
        """See `LiveOutput`."""
        if isinstance(message, LiveStart):
            self._connection = Client(("127.0.0.1", self._config.port), authkey=bytes.fromhex(self._config.authkey))
            self._connection.send(POSES)
            self._connection.send(message)
        elif isinstance(message, LiveDetections):
            self._views[message.detections.camera] = message
        elif self._connection is not None:
            if isinstance(message, LivePreview) and (view := self._views.get(message.camera)) is not None:
                self._connection.send(view)
            self._connection.send(message)

    def close(self) -> None:
        """See `LiveOutput`."""
        if self._connection is not None:
            self._connection.close()
