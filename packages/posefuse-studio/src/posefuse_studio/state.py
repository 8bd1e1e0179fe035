"""What all pages share: the workspace, its jobs, the streams and the rule of access."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field

from .access import Access
from .jobs import Jobs
from .live_link import LiveLink
from .session_messages import LIVE, WATCH
from .streams import Stream
from .workspace import StudioWorkspace


@dataclass(kw_only=True)
class Studio:
    """The state of one server; everything that must outlive it is in the workspace.

    Attributes:
        workspace: the files. access: who may look. jobs: long work. streams: what pages draw, by name.
        live: the live session that runs, if any. watch: the same of cameras that are watched without tracking.
        phone_may_record: whether the phone page may begin and end a recording; the owner allows it, until the server ends.
    """

    workspace: StudioWorkspace
    access: Access
    jobs: Jobs
    live: LiveLink
    watch: LiveLink
    streams: dict[str, Stream] = field(default_factory=dict)
    phone_may_record: bool = False
    _visitors: set[str] = field(default_factory=set)

    @classmethod
    def of(cls, workspace: StudioWorkspace, access: Access) -> Studio:
        """A new one."""
        jobs = Jobs(workspace)
        live, watch = LiveLink(jobs), LiveLink(jobs, WATCH)
        streams = {LIVE: live.stream, WATCH: watch.stream}
        return cls(workspace=workspace, access=access, jobs=jobs, live=live, watch=watch, streams=streams)

    async def came(self, visitor: str) -> None:
        """A page is being opened: look for sessions, so that it shows at once what runs."""
        self._visitors.add(visitor)
        links = (self.live, self.watch)
        for link in links:
            link.awake(True)
        await asyncio.gather(*(asyncio.to_thread(link.wait_looked) for link in links))

    def left(self, visitor: str) -> None:
        """A page is gone."""
        self._visitors.discard(visitor)
        for link in (self.live, self.watch):
            link.awake(bool(self._visitors))

    def stream(self, name: str, on_watched: Callable[[int], None] | None = None) -> Stream:
        """The stream of a name, made where it is missing; `on_watched` is of the one who makes it."""
        if name not in self.streams:
            self.streams[name] = Stream(on_watched)
        return self.streams[name]

    def drop_stream(self, name: str) -> None:
        """Forget a stream that is not needed any more."""
        self.streams.pop(name, None)
