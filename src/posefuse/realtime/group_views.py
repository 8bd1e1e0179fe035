"""Camera groups of this machine as the views of a session."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from typing import Any

from posefuse.foundation.channel import ChannelClosed

from .board import Board
from .clock import SessionClock
from .group import GroupPlan
from .messages import Status, Use, VideoFailed
from .networks import NetworkChooser
from .news import Say
from .pace import ProcessedImages
from .processes import Groups

_LEAD_NS = 300_000_000


class GroupViews(Groups):
    """Sends the groups the network to detect with, where `chooser` is given.

    Args:
        plans: one per group. board: what they look for. say: takes one line when the network changes.
    """

    def __init__(self, plans: Sequence[GroupPlan], board: Board, chooser: NetworkChooser | None, say: Say) -> None:
        super().__init__(plans, board)
        self._chooser, self._say = chooser, say
        self._notices: list[str] = []
        self._processed = ProcessedImages()

    def start(self, clock: SessionClock) -> int:
        """Recorded sources show their time 0 a moment from now, when all groups know it."""
        zero_ns = time.monotonic_ns() + _LEAD_NS
        self.begin(zero_ns)
        return zero_ns + clock.offset_ns

    def notices(self) -> list[str]:
        """Videos that ended early, and that this machine is too slow, each once."""
        new, self._notices = self._notices, []
        return new

    def messages(self) -> Iterator[Any]:
        """See `Groups.messages`; what failed of the videos goes to the notices."""
        for message in super().messages():
            if isinstance(message, VideoFailed):
                self._notices.append(f"video {message.camera}: failed: {message.reason}")
                continue
            if isinstance(message, Status):
                self._compare(message)
            if isinstance(message, Status) and self._chooser is not None:
                self._consider(message, self._chooser)
            yield message

    def _compare(self, status: Status) -> None:
        network = status.network or str(self._members[0].plan.detector.options.get("landmarks", ""))
        if sentence := self._processed.news(status, time.monotonic(), network):
            self._notices.append(sentence)

    def _consider(self, status: Status, chooser: NetworkChooser) -> None:
        if chooser.step(status, time.monotonic()):
            self._say(f"network {chooser.name} from now on: {chooser.why}")
        if status.network != chooser.name:
            for member in self._members:
                if member.plan.group == status.group:
                    # a process that ended is restarted, and its status shows that it needs the message
                    with contextlib.suppress(ChannelClosed):
                        member.channel.send(Use(chooser.name))
