"""What may be changed while a session runs: images for viewers, outputs, videos, names. From any thread, done between ticks."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from posefuse.core import LiveOutputConfig


@dataclass(frozen=True)
class ShowImages:
    """Small images per second and camera from now on; 0 for none."""

    rate_hz: float


@dataclass(frozen=True)
class KeepVideos:
    """Keep every camera's video in an existing folder from now on; None: no longer."""

    folder: Path | None


@dataclass(frozen=True)
class AddOutput:
    """Open another output."""

    name: str
    config: LiveOutputConfig


@dataclass(frozen=True)
class RemoveOutput:
    """Finish and close an output."""

    name: str


@dataclass(frozen=True)
class NamePerson:
    """Call a person so from now on; empty: no longer."""

    person: int
    name: str


Request = ShowImages | KeepVideos | AddOutput | RemoveOutput | NamePerson


class Controls:
    """A queue of requests."""

    def __init__(self) -> None:
        self._requests: queue.SimpleQueue[Request] = queue.SimpleQueue()

    def ask(self, request: Request) -> None:
        """From any thread; returns at once."""
        self._requests.put(request)

    def asked(self) -> Iterator[Request]:
        """What was asked for since the last call."""
        while not self._requests.empty():
            yield self._requests.get_nowait()
