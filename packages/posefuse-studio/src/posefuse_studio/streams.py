"""Binary messages to the pages: the newest of each kind wins, so that a slow page never delays the others or the session."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable
from typing import Any


class _Page:
    """One page's connection to a stream."""

    def __init__(self, kept: dict[Hashable, bytes]) -> None:
        self._pending, self._news = dict(kept), asyncio.Event()
        self._news.set()

    def put(self, key: Hashable, message: bytes) -> None:
        """Queue it in the place of an older one of the same key that was not sent yet."""
        self._pending[key] = message
        self._news.set()

    async def send(self, websocket: Any) -> None:
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
        sending = asyncio.create_task(page.send(websocket))
        try:
            # a page sends nothing: this ends when it goes away
            while (await websocket.receive())["type"] != "websocket.disconnect":
                pass
        finally:
            sending.cancel()
            self._pages.discard(page)
            self._on_watched(len(self._pages))
