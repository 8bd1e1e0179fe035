"""One clock for all processes of a session."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True)
class SessionClock:
    """Unix epoch as it was when the session began, carried on by the machine's monotonic clock: it never jumps.

    Attributes:
        offset_ns: session time minus monotonic time, the same in every process of the machine.
    """

    offset_ns: int

    @staticmethod
    def begin() -> SessionClock:
        """A clock that agrees with the machine's own now."""
        return SessionClock(time.time_ns() - time.monotonic_ns())

    def now_ns(self) -> int:
        """Session time."""
        return time.monotonic_ns() + self.offset_ns
