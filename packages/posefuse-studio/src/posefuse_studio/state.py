"""What all pages share: the workspace, its jobs, the streams and the rule of access."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from .access import Access
from .jobs import LIVE, WATCH, Jobs
from .live_link import LiveLink
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

    @classmethod
    def of(cls, workspace: StudioWorkspace, access: Access) -> Studio:
        """A new one."""
        jobs = Jobs(workspace)
        live, watch = LiveLink(jobs, LIVE), LiveLink(jobs, WATCH)
        streams = {LIVE: live.stream, WATCH: watch.stream}
        return cls(workspace=workspace, access=access, jobs=jobs, live=live, watch=watch, streams=streams)

    def begin(self) -> None:
        """Look for sessions; in the event loop that serves the pages."""
        for link in (self.live, self.watch):
            link.begin(asyncio.get_running_loop())

    def stream(self, name: str) -> Stream:
        """The stream of a name, made where it is missing."""
        return self.streams.setdefault(name, Stream())

    def drop_stream(self, name: str) -> None:
        """Forget a stream that is not needed any more."""
        self.streams.pop(name, None)
