"""Camera groups of this machine as the views of a session."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

from .board import Board
from .clock import SessionClock
from .group import GroupPlan
from .messages import Status, VideoFailed
from .pace import ProcessedImages
from .processes import Groups

_LEAD_NS = 300_000_000


class GroupViews(Groups):
    """`plans`: one per group; `board`: what they look for."""

    def __init__(self, plans: Sequence[GroupPlan], board: Board) -> None:
        super().__init__(plans, board)
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
            yield message

    def _compare(self, status: Status) -> None:
        network = str(self._members[0].plan.detector.options.get("landmarks", ""))
        if sentence := self._processed.news(status, time.monotonic(), network):
            self._notices.append(sentence)
