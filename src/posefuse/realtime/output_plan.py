"""Where a session sends its results, and what of that the session sees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from posefuse.core import LiveMessage, LiveOutputConfig, LiveStart, Rig

from .clock import SessionClock

PROCESS = "process"


class SessionReader(Protocol):
    """A program that reads a session."""

    takes: tuple[type[LiveMessage], ...]

    def take(self, message: LiveMessage) -> None:
        """Send it on without waiting."""
        ...


@dataclass(frozen=True, kw_only=True)
class OutputPlan:
    """Where a session sends its results.

    Attributes:
        rig: the cameras. clock: of the session. rate_hz: output rate. configs: of the outputs, by name.
        notes: how the session was made, see `provenance`. names: of the people, in the order of their ids.
        reader: the program that began the session, if any; takes messages in the session's own thread.
    """

    rig: Rig
    clock: SessionClock
    rate_hz: float = 100.0
    configs: Mapping[str, LiveOutputConfig] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    reader: SessionReader | None = None

    def wants(self, kind: type[LiveMessage]) -> bool:
        """Whether any output, or the reader, takes such messages."""
        read = self.reader is not None and kind in self.reader.takes
        return read or any(kind in config.takes for config in self.configs.values())

    @property
    def wants_newest(self) -> bool:
        """Whether any output is better off with a message now than with all of them later."""
        return not all(config.keeps_all for config in self.configs.values())

    def start(self) -> LiveStart:
        """The first message."""
        return LiveStart(
            t_ns=self.clock.now_ns(),
            rig=self.rig,
            rate_hz=self.rate_hz,
            clock_offset_ns=self.clock.offset_ns,
            notes=self.notes,
            names=self.names,
        )


def check_live_outputs(configs: Mapping[str, LiveOutputConfig]) -> None:
    """Build each output once, so that a missing package is named before any work; raises DependencyError."""
    for config in configs.values():
        config.build().close()


@dataclass(frozen=True)
class OutputEvent:
    """An output's state has changed. `t_ns`: session time; `output`: its name, or ``process`` for all of them."""

    t_ns: int
    output: str
    state: str
    text: str
