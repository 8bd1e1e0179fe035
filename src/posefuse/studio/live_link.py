"""The server's side of a running session: its messages to the pages, and the pages' requests to it."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from multiprocessing.connection import Client, Connection
from typing import Any

from .jobs import Job, Jobs
from .live_host import BODIES, SCENE
from .streams import Stream

LIVE, WATCH = "live", "watch"
"""Kinds of work that pages follow, and the names of their streams."""
LIVE_BODIES = "live-bodies"
"""Name of the stream of meshes."""
_LOOK_S = 0.7
_FIRST_LOOK_S = 1.0


class LiveLink:
    """Follows whatever session of a kind runs in the workspace, whichever server started it; while there are pages, see `awake`.

    Args:
        work: `LIVE` or `WATCH`.

    Attributes:
        stream: what the pages draw. bodies: meshes of people, for pages that show them.
        status: the newest values of the work; empty while no session runs.
        job: of the session; None while none runs.
    """

    def __init__(self, jobs: Jobs, work: str = LIVE) -> None:
        self.stream, self.bodies = Stream(self._watched), Stream(self._watched)
        self.status: Mapping[str, Any] = {}
        self.job: Job | None = None
        self._jobs, self._work = jobs, work
        self._connection: Connection | None = None
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._awake, self._looked = threading.Event(), threading.Event()

    def awake(self, on: bool) -> None:
        """Whether to look for sessions at all: a server without a page costs nothing then."""
        if on:
            self._awake.set()
        else:
            self._awake.clear()

    def wait_looked(self) -> None:
        """Until it is known whether a session runs; at most a second, as one that hangs must not keep a page from opening."""
        self._looked.wait(_FIRST_LOOK_S)

    def begin(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begin; `loop`: where the stream is served."""
        self._loop = loop
        threading.Thread(target=self._run, name=f"link {self._work}", daemon=True).start()

    def ask(self, request: str, /, **values: Any) -> None:
        """Send a request to the session; without one nothing happens."""
        with self._lock, suppress(OSError):
            if self._connection is not None:
                self._connection.send((request, values))

    def _watched(self, pages: int = 0) -> None:
        """Say which streams any page shows."""
        shown = {SCENE: self.stream, BODIES: self.bodies}
        self.ask("watch", channels=[channel for channel, stream in shown.items() if stream.watched])

    def _run(self) -> None:
        while True:
            if not self._awake.is_set():
                self._looked.clear()
                self._awake.wait()
            running = self._jobs.running(self._work)
            self.job = running[0] if running else None
            address = self._jobs.report(self.job.id).extra.get("address") if self.job else None
            if address:
                with suppress(OSError, EOFError, ValueError):
                    self._follow(int(address["port"]), bytes.fromhex(address["key"]))
            self.status = {}
            if self._awake.is_set():
                self._looked.set()
                time.sleep(_LOOK_S)

    def _follow(self, port: int, key: bytes) -> None:
        """Until the session ends, or no page is left."""
        with Client(("127.0.0.1", port), authkey=key) as connection:
            self._connection = connection
            try:
                self._watched()
                while self._awake.is_set():
                    self._take(*connection.recv())
            finally:
                with self._lock:
                    self._connection = None

    def _take(self, kind: str, channel: str, key: Any, content: Any) -> None:
        if kind == "status":
            self.status = content
            self._looked.set()
        elif self._loop is not None:
            self._loop.call_soon_threadsafe(self._publish, kind, channel, key, content)

    def _publish(self, kind: str, channel: str, key: Any, content: bytes) -> None:
        stream = self.bodies if channel == BODIES else self.stream
        stream.publish(key, content, keep=kind == "kept")
