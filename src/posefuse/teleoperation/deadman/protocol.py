"""What a dead-man's switch offers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from posefuse.teleoperation.heartbeats import Beat
from posefuse.teleoperation.values import OperatorView


@dataclass(frozen=True, kw_only=True)
class Pressed:
    """What came since the last poll. emergency: stop now, until a reset. reset: leave STOPPED."""

    beats: tuple[Beat, ...] = ()
    emergency: bool = False
    reset: bool = False


class DeadMan(Protocol):
    """A switch that a person must hold."""

    @property
    def hint(self) -> str:
        """How to use it, in one line."""
        ...

    def poll(self, now_ns: int, view: OperatorView | None) -> Pressed:
        """What came since the last call; never waits. `view`: the operator in the newest pose."""
        ...

    def close(self) -> None:
        """Safe to call twice."""
        ...
