"""Where a session sends its results, and what of that the session sees."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from posefuse.core import LiveMessage, LiveOutputConfig, LiveStart, OutputHealth, Rig

from .clock import SessionClock

PROCESS = "process"


@dataclass(frozen=True, kw_only=True)
class OutputPlan:
    """Where a session sends its results.

    Attributes:
        rig: the cameras. clock: of the session. rate_hz: output rate. configs: of the outputs, by name.
        notes: how the session was made, see `provenance`. names: of the people, in the order of their ids.
    """

    rig: Rig
    clock: SessionClock
    rate_hz: float = 100.0
    configs: Mapping[str, LiveOutputConfig] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)
    names: tuple[str, ...] = ()

    def wants(self, kind: type[LiveMessage]) -> bool:
        """Whether any output takes such messages."""
        return any(kind in config.takes for config in self.configs.values())

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


class Outlets(Protocol):
    """Where the messages of a session go; never waits."""

    @property
    def health(self) -> Mapping[str, OutputHealth]:
        """How the outputs fare, by name."""
        ...

    @property
    def events(self) -> Iterable[OutputEvent]:
        """The newest changes, oldest first."""
        ...

    @property
    def event_count(self) -> int:
        """How many changes there ever were."""
        ...

    def offer(self, message: LiveMessage) -> None:
        """Hand a message on."""
        ...

    def poll(self) -> None:
        """Take in how the outputs fare; several times a second."""
        ...


class NoOutputs:
    """Nothing leaves: only figures are wanted."""

    lost, failed, event_count = 0, False, 0
    events: tuple[OutputEvent, ...] = ()
    health: Mapping[str, OutputHealth] = {}

    def whereabouts(self) -> str:
        """Nowhere."""
        return ""

    def figures(self) -> dict[str, dict[str, Any]]:
        """None."""
        return {}

    def wait_ready(self) -> None:
        """Nothing to wait for."""

    def add(self, name: str, config: LiveOutputConfig) -> None:
        """Nothing is opened: a session that is controlled has outputs."""

    def remove(self, name: str) -> None:
        """Nothing to close."""

    def offer(self, message: LiveMessage) -> None:
        """Dropped: no output takes it."""

    def poll(self) -> None:
        """Nothing to take in."""

    def close(self) -> None:
        """Nothing to close."""
