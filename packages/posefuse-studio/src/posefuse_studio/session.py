"""Between the process of a session (`Host`) and the servers that show it (`state.LiveLink`).

A message is a line of JSON, then bytes. From the session: whether it is kept, and its key, then what a page draws; with the key
`STATUS` the session's state as JSON.
From the server: a request by name with values. They are sent over `multiprocessing.connection`, whose two ends prove that they
have the same key, as bytes alone: its objects could run. Nothing in a message can run; everything is checked.

Servers may start and end without effect on the session. While no page shows it, nothing is packed and no image is made.
"""

from __future__ import annotations

import json
import logging
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, Listener
from typing import Any, Literal

from posefuse.core import OutputHealth

from .workspace import SessionAddress, adapter

MOST_BYTES = 64 * 2**20
# between two reports of a session's state
STATUS_S = 0.25
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class CameraStatus:
    """One camera of a session.

    Attributes:
        light: how it is, see `shell.light`. state: one word. text: what is wrong, and what to do; empty where nothing is.
        figures: size, rates or latency in a line. size_wh: of its images; None before the first.
    """

    light: Literal["good", "doubt", "bad"]
    state: str
    text: str = ""
    figures: str = ""
    size_wh: tuple[int, int] | None = None


@dataclass(frozen=True, kw_only=True)
class SessionStatus:
    """State of a session that tracks people, or only looks at its cameras.

    Attributes:
        cameras: by name. recording: the folder that is recorded to, for so many `seconds`; empty while none is.
        people: ids of those seen. person: whose angles, named `plots`, are shown.
        outputs: by name. wanted: those that were switched on. latency_p95_ms: None while it is not known.
        news, refused: newest lines of what happened, and of requests that could not be met.
        words, enough: what to do with the target, and whether what was seen of it is enough.
    """

    cameras: dict[str, CameraStatus] = field(default_factory=dict)
    recording: str = ""
    seconds: float = 0.0
    people: list[int] = field(default_factory=list)
    person: int | None = None
    plots: list[str] = field(default_factory=list)
    outputs: dict[str, OutputHealth] = field(default_factory=dict)
    wanted: list[str] = field(default_factory=list)
    latency_p95_ms: float | None = None
    news: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    words: str = ""
    enough: bool = False


STATUS = "status"
HEAD, _REQUEST = adapter(tuple[bool, str]), adapter(tuple[str, dict[str, Any]])


class _Watcher:
    """One server. A thread sends to it, the newest of each key, so that one that hangs delays nothing."""

    def __init__(self, connection: Connection) -> None:
        self.looking = self.gone = False
        self._connection = connection
        self._pending: dict[str, tuple[bool, bytes]] = {}
        self._news = threading.Condition()
        threading.Thread(target=self._send, daemon=True).start()

    def put(self, key: str, content: bytes, *, keep: bool) -> None:
        """Queue it in the place of an older one."""
        with self._news:
            self._pending[key] = keep, content
            self._news.notify()

    def _send(self) -> None:
        with suppress(OSError):
            while not self.gone:
                with self._news:
                    self._news.wait_for(lambda: bool(self._pending), 1.0)
                    pending, self._pending = self._pending, {}
                for key, (keep, content) in pending.items():
                    self._connection.send_bytes(json.dumps([keep, key]).encode() + b"\n" + content)
        self.gone = True


class Host:
    """Listens on the loopback address for servers that know the key.

    Args:
        requests: by name, what takes the values of a request of a server; may raise anything, which is logged.
        on_watched: whether any page looks at the scene; called when that changes.

    Attributes:
        watched: whether any page looks.
    """

    def __init__(
        self, requests: Mapping[str, Callable[..., object]] | None = None, on_watched: Callable[[bool], object] = bool
    ) -> None:
        self._key = secrets.token_bytes(32)
        self._listener = Listener(("127.0.0.1", 0), authkey=self._key)
        self._watchers: list[_Watcher] = []
        self._kept: dict[str, bytes] = {}
        self.watched = False
        self._requests, self._on_watched = requests or {}, on_watched
        self._lock = threading.RLock()
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def address(self) -> SessionAddress:
        """Where it is, and the key."""
        return SessionAddress(port=int(self._listener.address[1]), key=self._key)

    def publish(self, key: str, content: bytes, *, keep: bool = False) -> None:
        """To all servers whose pages look; with `keep` to all, also to those that come later."""
        with self._lock:
            if keep:
                self._kept[key] = content
            for watcher in self._watchers:
                if keep or watcher.looking:
                    watcher.put(key, content, keep=keep)

    def status(self, values: SessionStatus) -> None:
        """To all servers."""
        self.publish(STATUS, adapter(SessionStatus).dump_json(values), keep=True)

    def _accept(self) -> None:
        while True:
            try:
                connection = self._listener.accept()
            except Exception:  # noqa: BLE001 - a stranger at the port must not end the session
                continue
            watcher = _Watcher(connection)
            with self._lock:
                self._watchers.append(watcher)
                for key, content in self._kept.items():
                    watcher.put(key, content, keep=True)
            threading.Thread(target=self._receive, args=(connection, watcher), daemon=True).start()

    def _receive(self, connection: Connection, watcher: _Watcher) -> None:
        with suppress(EOFError, OSError):
            while True:
                raw = connection.recv_bytes(MOST_BYTES)
                try:
                    name, values = _REQUEST.validate_json(raw)
                    if name == "watch":
                        watcher.looking = values["on"] is True
                        self._count()
                    else:
                        self._requests[name](**values)
                except Exception as error:  # noqa: BLE001 - a request that is damaged, or cannot be met, must not end the others
                    _log.warning("request refused: %s: %s", type(error).__name__, error)
        watcher.gone = True
        with self._lock:
            self._watchers.remove(watcher)
        self._count()

    def _count(self) -> None:
        with self._lock:
            before, self.watched = self.watched, any(watcher.looking for watcher in self._watchers)
        if self.watched != before:
            self._on_watched(self.watched)


class Pace:
    """True when something is due, at a limited rate."""

    def __init__(self, every_s: float) -> None:
        self._every_s, self._next_s = every_s, 0.0

    def due(self) -> bool:
        """Whether it is; the next time follows."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            return False
        self._next_s = max(self._next_s + self._every_s, now_s - self._every_s)
        return True
