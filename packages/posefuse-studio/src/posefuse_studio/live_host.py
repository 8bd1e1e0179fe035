"""Between a live session and the servers that show it: packs what pages draw, receives their requests.

It runs in the session's job. Servers may start and end without effect on the session. While no page is open, nothing is
packed and no image is made.
"""

from __future__ import annotations

import logging
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection, Listener
from typing import Any

from .private_files import SessionAddress
from .session_messages import MOST_BYTES, SessionMessage, packed_status, unpacked_request

_STATUS_S = 0.25
_IDLE_STATUS_S = 1.0
_log = logging.getLogger(__name__)


class Watcher:
    """One server. A thread sends to it, the newest of each key, so that one that hangs delays nothing."""

    def __init__(self, connection: Connection) -> None:
        self.looking = False
        self._connection = connection
        self._pending: dict[tuple[str, str], SessionMessage] = {}
        self._news = threading.Condition()
        self.gone = False
        threading.Thread(target=self._send, daemon=True).start()

    def put(self, message: SessionMessage) -> None:
        """Queue it in the place of an older one."""
        with self._news:
            self._pending[_place(message)] = message
            self._news.notify()

    def _send(self) -> None:
        with suppress(OSError):
            while not self.gone:
                with self._news:
                    self._news.wait_for(lambda: bool(self._pending), 1.0)
                    pending, self._pending = list(self._pending.values()), {}
                for message in pending:
                    self._connection.send_bytes(message.packed())
        self.gone = True


class Host:
    """Listens on the loopback address for servers that know the key.

    Args:
        on_request: takes what a server asks for, by name and values; may raise anything, which is logged.
        on_watched: whether any page looks at the scene; called when that changes.

    Attributes:
        watched: whether any page looks.
    """

    def __init__(self, on_request: Callable[[str, Mapping[str, Any]], None], on_watched: Callable[[bool], None]) -> None:
        self._key = secrets.token_bytes(32)
        self._listener = Listener(("127.0.0.1", 0), authkey=self._key)
        self._watchers: list[Watcher] = []
        self._kept: dict[tuple[str, str], SessionMessage] = {}
        self.watched = False
        self._on_request, self._on_watched = on_request, on_watched
        self._lock = threading.RLock()
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def address(self) -> SessionAddress:
        """Where it is, and the key."""
        return SessionAddress(port=int(self._listener.address[1]), key=self._key)

    def publish(self, key: str, message: bytes, *, keep: bool = False) -> None:
        """To all servers whose pages look; with `keep` to all, also to those that come later."""
        self._put(SessionMessage(kind="kept" if keep else "stream", key=key, content=message))

    def status(self, values: Mapping[str, Any]) -> None:
        """To all servers; `values`: see `session_messages`."""
        self._put(SessionMessage(kind="status", key="", content=packed_status(values)))

    def _put(self, message: SessionMessage) -> None:
        keep = message.kind != "stream"
        with self._lock:
            if keep:
                self._kept[_place(message)] = message
            for watcher in self._watchers:
                if keep or watcher.looking:
                    watcher.put(message)

    def _accept(self) -> None:
        while True:
            try:
                connection = self._listener.accept()
            except Exception:  # noqa: BLE001 - a stranger at the port must not end the session
                continue
            watcher = Watcher(connection)
            with self._lock:
                self._watchers.append(watcher)
                for message in self._kept.values():
                    watcher.put(message)
            threading.Thread(target=self._hear, args=(connection, watcher), daemon=True).start()

    def _hear(self, connection: Connection, watcher: Watcher) -> None:
        with suppress(EOFError, OSError):
            while True:
                raw = connection.recv_bytes(MOST_BYTES)
                try:
                    self._take(*unpacked_request(raw), watcher)
                except Exception as error:  # noqa: BLE001 - a request that is damaged, or cannot be met, must not end the others
                    _log.warning("request refused: %s: %s", type(error).__name__, error)
        watcher.gone = True
        with self._lock:
            self._watchers.remove(watcher)
        self._count()

    def _take(self, name: str, values: Mapping[str, Any], watcher: Watcher) -> None:
        if name == "watch":
            watcher.looking = values["on"] is True
            self._count()
        else:
            self._on_request(name, values)

    def _count(self) -> None:
        with self._lock:
            before, self.watched = self.watched, any(watcher.looking for watcher in self._watchers)
        if self.watched != before:
            self._on_watched(self.watched)


def _place(message: SessionMessage) -> tuple[str, str]:
    return message.kind, message.key


class Pace:
    """True when something is due, at a limited rate."""

    def __init__(self, every_s: float) -> None:
        self.every_s, self._next_s = every_s, 0.0

    def due(self) -> bool:
        """Whether it is; the next time follows."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            return False
        self._next_s = max(self._next_s + self.every_s, now_s - self.every_s)
        return True


class Rates:
    """Frames per second of each camera, from counts that are read now and then."""

    def __init__(self) -> None:
        self._counted: dict[str, tuple[float, float]] = {}
        self._hz: dict[str, float] = {}

    def hz(self, name: str, count: float) -> float:
        """With the count of now; over at least a second, 0 before that."""
        now_s = time.monotonic()
        before_s, before = self._counted.setdefault(name, (now_s, count))
        if now_s - before_s >= 1.0:
            self._hz[name] = (count - before) / (now_s - before_s)
            self._counted[name] = now_s, count
        return self._hz.get(name, 0.0)


def status_pace(watched: bool) -> float:
    """Seconds between two reports of the session's state."""
    return _STATUS_S if watched else _IDLE_STATUS_S
