"""What all pages share: the workspace, its jobs, the streams and the rule of access."""

from __future__ import annotations

import asyncio
import json
import logging
import threading
import time
from collections.abc import Callable, Hashable
from contextlib import suppress
from multiprocessing.connection import Client, Connection
from typing import Any

from nicegui import Client as NiceguiClient
from nicegui.binding import BindableProperty
from pydantic import ValidationError

from posefuse_studio.access import Access
from posefuse_studio.jobs import LIVE, WATCH, Job, Jobs
from posefuse_studio.session import HEAD, MOST_BYTES, STATUS, SessionStatus
from posefuse_studio.workspace import SessionAddress, StudioWorkspace, adapter


class _Page:
    """One page's connection to a stream."""

    def __init__(self, kept: dict[Hashable, bytes]) -> None:
        self._pending, self._news = dict(kept), asyncio.Event()
        self._news.set()

    def put(self, key: Hashable, message: bytes) -> None:
        """Queue it in the place of an older one of the same key that was not sent yet."""
        self._pending[key] = message
        self._news.set()

    async def deliver(self, websocket: Any) -> None:
        """For ever; keys take turns."""
        while await self._news.wait():
            while self._pending:
                await websocket.send_bytes(self._pending.pop(next(iter(self._pending))))
            self._news.clear()


class Stream:
    """Messages for all pages that show one thing, e.g. the live session or one recording.

    A message of a kept key (what is drawn, and where everything stands) is sent to pages that come later, too.

    Args:
        on_watched: called with the number of pages whenever it changes, in the event loop.
    """

    def __init__(self, on_watched: Callable[[int], object] = bool) -> None:
        self._pages: set[_Page] = set()
        self._kept: dict[Hashable, bytes] = {}
        self._on_watched = on_watched

    @property
    def watched(self) -> bool:
        """Whether any page shows it."""
        return bool(self._pages)

    def publish(self, key: Hashable, message: bytes, *, keep: bool = False) -> None:
        """Send to all pages; call in the event loop."""
        if keep:
            self._kept[key] = message
        for page in self._pages:
            page.put(key, message)

    async def serve(self, websocket: Any) -> None:
        """Send to one page until it goes away. `websocket`: an accepted one."""
        page = _Page(self._kept)
        self._pages.add(page)
        self._on_watched(len(self._pages))
        sending = asyncio.create_task(page.deliver(websocket))
        try:
            # a page sends nothing: this ends when it goes away
            while (await websocket.receive())["type"] != "websocket.disconnect":
                pass
        finally:
            sending.cancel()
            self._pages.discard(page)
            self._on_watched(len(self._pages))


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
            keep, key = HEAD.validate_json(head)
            if key == STATUS:
                self._in_loop(self._show, adapter(SessionStatus).validate_json(content))
            else:
                self._in_loop(lambda: self.stream.publish(key, content, keep=keep))
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


class Studio:
    """The state of one server; everything that must outlive it is in the workspace.

    Attributes:
        workspace: the files. access: who may look. jobs: long work. streams: what pages draw, by name.
        live: the live session that runs, if any. watch: the same of cameras that are watched without tracking.
        phone_may_record: whether the phone page may begin and end a recording; the owner allows it, until the server ends.
    """

    def __init__(self, workspace: StudioWorkspace, access: Access) -> None:
        self.workspace, self.access, self.jobs = workspace, access, Jobs(workspace)
        self.live, self.watch = LiveLink(self.jobs, LIVE), LiveLink(self.jobs, WATCH)
        self.streams = {LIVE: self.live.stream, WATCH: self.watch.stream}
        self.phone_may_record = False

    def begin(self) -> None:
        """Look for sessions; in the event loop that serves the pages."""
        for link in (self.live, self.watch):
            link.begin(asyncio.get_running_loop())

    def page_stream(self, client: NiceguiClient) -> str:
        """The name of a stream of one visitor's page, which goes with it."""
        name = f"page-{client.id}"
        self.streams[name] = Stream()
        client.on_delete(lambda: self.streams.pop(name))
        return name
