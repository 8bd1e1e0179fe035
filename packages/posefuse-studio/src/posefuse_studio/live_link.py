"""The server's side of a running session: its messages to the pages, and the pages' requests to it."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from multiprocessing.connection import Client, Connection
from typing import Any

from .jobs import Job, Jobs
from .private_files import SessionAddress
from .session_messages import LIVE, MOST_BYTES, DamagedMessage, SessionMessage, packed_request, unpacked_status
from .streams import Stream

_LOOK_S = 0.7
_FIRST_LOOK_S = 1.0
_log = logging.getLogger(__name__)


class LiveLink:
    """Follows whatever session of a kind runs in the workspace, whichever server started it; while there are pages, see `awake`.

    Args:
        work: `LIVE` or `WATCH`.

    Attributes:
        stream: what the pages draw.
        status: the newest values of the work; empty while no session runs.
        job: of the session; None while none runs.
    """

    def __init__(self, jobs: Jobs, work: str = LIVE) -> None:
        self.stream = Stream(self._watched)
        self.status: Mapping[str, Any] = {}
        self.job: Job | None = None
        self._jobs, self._work = jobs, work
        self._connection: Connection | None = None
        self._troubles = 0
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
                self._connection.send_bytes(packed_request(request, values))

    def _watched(self, pages: int = 0) -> None:
        """Report whether any page shows the stream."""
        self.ask("watch", on=self.stream.watched)

    def _run(self) -> None:
        while True:
            if not self._awake.is_set():
                self._looked.clear()
                self._awake.wait()
            try:
                self._look()
            except (OSError, EOFError):
                # a session that ends closes its side
                pass
            except Exception as error:  # noqa: BLE001 - whatever a session or a file is, the next look may find another one
                self._warn(f"connection to the session lost: {type(error).__name__}: {error}")
            self.status = {}
            if self._awake.is_set():
                self._looked.set()
                time.sleep(_LOOK_S)

    def _look(self) -> None:
        running = self._jobs.running(self._work)
        self.job = running[0] if running else None
        address = self._jobs.address(self.job.id) if self.job else None
        if address is not None:
            self._follow(address)

    def _follow(self, address: SessionAddress) -> None:
        """Until the session ends, or no page is left."""
        with Client(("127.0.0.1", address.port), authkey=address.key) as connection:
            self._connection = connection
            try:
                self._watched()
                while self._awake.is_set():
                    self._take(connection.recv_bytes(MOST_BYTES))
            finally:
                with self._lock:
                    self._connection = None

    def _take(self, raw: bytes) -> None:
        try:
            message = SessionMessage.unpacked(raw)
            if message.kind == "status":
                self.status = unpacked_status(self._work, message.content)
                self._looked.set()
                return
        except DamagedMessage as error:
            self._warn(f"damaged message from the session: {error}")
            return
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._publish, message)

    def _warn(self, line: str) -> None:
        """A line for the first, second, fourth, eighth ... trouble: there may be hundreds a second."""
        self._troubles += 1
        if self._troubles.bit_count() == 1:
            _log.warning("%s: %s; %d so far", self._work, line, self._troubles)

    def _publish(self, message: SessionMessage) -> None:
        self.stream.publish(message.key, message.content, keep=message.kind == "kept")
