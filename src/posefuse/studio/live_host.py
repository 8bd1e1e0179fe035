"""Between a live session and the servers that show it: packs what pages draw, receives their requests.

It runs in the session's job. Servers may start and end without effect on the session. While no page is open, nothing is
packed and no image is made.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable, Hashable, Mapping
from contextlib import suppress
from multiprocessing.connection import Connection, Listener
from typing import Any

_STATUS_S = 0.25
_IDLE_STATUS_S = 1.0

SCENE, BODIES = "scene", "bodies"
"""Channels: what all pages draw; meshes of people, for pages that show them."""

Message = tuple[str, str, Hashable, Any]
"""Kind (``stream``, ``kept`` or ``status``), channel, key, and bytes or values."""


class Watcher:
    """One server. A thread sends to it, the newest of each key, so that one that hangs delays nothing."""

    def __init__(self, connection: Connection) -> None:
        self.wanted: frozenset[str] = frozenset()
        self._connection = connection
        self._pending: dict[Hashable, Message] = {}
        self._news = threading.Condition()
        self.gone = False
        threading.Thread(target=self._send, daemon=True).start()

    def put(self, message: Message) -> None:
        """Queue it in the place of an older one."""
        with self._news:
            self._pending[message[:3]] = message
            self._news.notify()

    def _send(self) -> None:
        with suppress(OSError):
            while not self.gone:
                with self._news:
                    self._news.wait_for(lambda: bool(self._pending), 1.0)
                    pending, self._pending = list(self._pending.values()), {}
                for message in pending:
                    self._connection.send(message)
        self.gone = True


class Host:
    """Listens on the loopback address for servers that know the key.

    Args:
        on_request: takes what a server asks for, by name and values; may raise anything, which is shown as a refusal.
        on_watched: whether any page looks at the scene; called when that changes.
    """

    def __init__(self, on_request: Callable[[str, Mapping[str, Any]], None], on_watched: Callable[[bool], None]) -> None:
        self._key = secrets.token_bytes(32)
        self._listener = Listener(("127.0.0.1", 0), authkey=self._key)
        self._watchers: list[Watcher] = []
        self._kept: dict[Hashable, Message] = {}
        self._on_request, self._on_watched = on_request, on_watched
        self._wanted: frozenset[str] = frozenset()
        self._lock = threading.RLock()
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def address(self) -> dict[str, Any]:
        """Where it is and the key, as JSON values; for the workspace's owner only."""
        return {"port": self._listener.address[1], "key": self._key.hex()}

    @property
    def watched(self) -> bool:
        """Whether any page looks."""
        return self.wanted(SCENE)

    def wanted(self, channel: str) -> bool:
        """Whether any page shows what goes over this channel."""
        return channel in self._wanted

    def publish(self, key: Hashable, message: bytes, *, keep: bool = False, channel: str = SCENE) -> None:
        """To all servers whose pages look; with `keep` to all, also to those that come later."""
        self._put(("kept" if keep else "stream", channel, key, message), keep)

    def status(self, values: Mapping[str, Any]) -> None:
        """To all servers."""
        self._put(("status", SCENE, "", dict(values)), True)

    def _put(self, message: Message, keep: bool) -> None:
        with self._lock:
            if keep:
                self._kept[message[:3]] = message
            for watcher in self._watchers:
                if keep or message[1] in watcher.wanted:
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
                name, values = connection.recv()
                if name == "watch":
                    watcher.wanted = frozenset(values["channels"])
                    self._count()
                else:
                    self._on_request(name, values)
        watcher.gone = True
        with self._lock:
            self._watchers.remove(watcher)
        self._count()

    def _count(self) -> None:
        with self._lock:
            before, self._wanted = self._wanted, frozenset[str]().union(*(watcher.wanted for watcher in self._watchers))
            watched = SCENE in self._wanted
        if watched != (SCENE in before):
            self._on_watched(watched)


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
