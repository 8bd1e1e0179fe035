"""The server's side of a running session: its messages to the pages, and the pages' requests to it."""

from __future__ import annotations

import asyncio
import json
import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Client, Connection
from typing import Any

from nicegui.binding import BindableProperty
from pydantic import ValidationError

from .jobs import LIVE, Job, Jobs
from .session import HEAD, MOST_BYTES, SessionStatus
from .stored import SessionAddress, adapter
from .streams import Stream

_LOOK_S = 0.7
_log = logging.getLogger(__name__)


class LiveLink:
    """Follows whatever session of a kind runs in the workspace, whichever server started it.

    Args:
        work: `LIVE` or `WATCH`.

    Attributes:
        stream: what the pages draw. status: the newest of the session; empty while none runs. job: of the session, if any.
    """

    status: SessionStatus = BindableProperty()  # type: ignore[assignment]

    def __init__(self, jobs: Jobs, work: str = LIVE) -> None:
        self.stream = Stream(lambda pages: self.ask("watch", on=pages > 0))
        self.status = SessionStatus()
        self.job: Job | None = None
        self._jobs, self._work = jobs, work
        self._connection: Connection | None = None
        self._troubles = 0
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None

    def begin(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begin; `loop`: where the stream is served."""
        self._loop = loop
        threading.Thread(target=self._run, name=f"link {self._work}", daemon=True).start()

    def ask(self, request: str, /, **values: Any) -> None:
        """Send a request to the session; without one nothing happens."""
        with self._lock, suppress(OSError):
            if self._connection is not None:
                self._connection.send_bytes(json.dumps([request, values]).encode())

    def _run(self) -> None:
        while True:
            try:
                running = self._jobs.running(self._work)
                self.job = running[0] if running else None
                if self.job and (address := self._jobs.address(self.job.id)):
                    self._follow(address)
            except (OSError, EOFError):
                # a session that ends closes its side
                pass
            except Exception as error:  # noqa: BLE001 - whatever a session or a file is, the next look may find another one
                self._warn(f"connection to the session lost: {type(error).__name__}: {error}")
            self._in_loop(self._show, SessionStatus())
            time.sleep(_LOOK_S)

    def _follow(self, address: SessionAddress) -> None:
        """Until the session ends."""
        with Client(("127.0.0.1", address.port), authkey=address.key) as connection:
            self._connection = connection
            try:
                self.ask("watch", on=self.stream.watched)
                while True:
                    self._take(connection.recv_bytes(MOST_BYTES))
            finally:
                with self._lock:
                    self._connection = None

    def _take(self, raw: bytes) -> None:
        head, _, content = raw.partition(b"\n")
        try:
            kind, key = HEAD.validate_json(head)
            if kind == "status":
                self._in_loop(self._show, adapter(SessionStatus).validate_json(content))
            else:
                self._in_loop(lambda: self.stream.publish(key, content, keep=kind == "kept"))
        except ValidationError as error:
            first = error.errors()[0]
            self._warn(f"damaged message from the session: {'.'.join(map(str, first['loc']))}: {first['msg']}")

    def _show(self, status: SessionStatus) -> None:
        self.status = status

    def _in_loop(self, call: Callable[..., object], *values: object) -> None:
        """Where the pages are; after the server's end nowhere."""
        if self._loop is not None:
            with suppress(RuntimeError):
                self._loop.call_soon_threadsafe(call, *values)

    def _warn(self, line: str) -> None:
        """A line for the first, second, fourth, eighth ... trouble: there may be hundreds a second."""
        self._troubles += 1
        if self._troubles.bit_count() == 1:
            _log.warning("%s: %s; %d so far", self._work, line, self._troubles)
