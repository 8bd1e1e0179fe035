"""Binary messages to the pages: the newest of each kind wins, so that a slow page never delays the others or the session."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Hashable
from typing import Any


class Subscriber:
    """One page's connection to a stream."""

    def __init__(self) -> None:
        self._pending: dict[Hashable, bytes] = {}
        self._news = asyncio.Event()

    def put(self, key: Hashable, message: bytes) -> None:
        """Queue it in the place of an older one of the same key that was not sent yet."""
        self._pending[key] = message
        self._news.set()

    async def next(self) -> bytes:
        """Wait for a message; keys take turns."""
        while not self._pending:
            self._news.clear()
            await self._news.wait()
        return self._pending.pop(next(iter(self._pending)))


class Stream:
    """Messages for all pages that show one thing, e.g. the live session or one recording.

    A message of a kept key (what is drawn, and where everything stands) is sent to pages that come later, too.

    Args:
        on_watched: called with the number of pages whenever it changes, in the event loop.
    """

    def __init__(self, on_watched: Callable[[int], None] | None = None) -> None:
        self._subscribers: set[Subscriber] = set()
        self._kept: dict[Hashable, bytes] = {}
        self._on_watched = on_watched

    @property
    def watched(self) -> bool:
        """Whether any page shows it."""
        return bool(self._subscribers)

    def publish(self, key: Hashable, message: bytes, *, keep: bool = False) -> None:
        """Send to all pages; call in the event loop."""
        if keep:
            self._kept[key] = message
        for subscriber in self._subscribers:
            subscriber.put(key, message)

    async def serve(self, websocket: Any) -> None:
        """Send to one page until it goes away. `websocket`: an accepted one."""
        subscriber = Subscriber()
        for key, message in self._kept.items():
            subscriber.put(key, message)
        self._subscribers.add(subscriber)
        self._report_subscribers()
        sending = asyncio.create_task(_send(subscriber, websocket))
        try:
            # a page sends nothing: this ends when it goes away
            while (await websocket.receive())["type"] != "websocket.disconnect":
                pass
        finally:
            sending.cancel()
            self._subscribers.discard(subscriber)
            self._report_subscribers()

    def _report_subscribers(self) -> None:
        if self._on_watched is not None:
            self._on_watched(len(self._subscribers))


async def _send(subscriber: Subscriber, websocket: Any) -> None:
    while True:
        await websocket.send_bytes(await subscriber.next())
