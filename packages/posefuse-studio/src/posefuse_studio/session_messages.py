"""What a session and a server send each other: a line of JSON, then bytes. Nothing in it can run; everything is checked.

From the session: kind and key, then what a page draws, or the session's state as JSON. From the server: a request by
name with values. They are sent over `multiprocessing.connection`, whose two ends prove that they have the same key, as bytes
alone: its objects are pickles.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

LIVE, WATCH = "live", "watch"
"""Kinds of work that pages follow, and the names of their streams."""
MOST_BYTES = 64 * 2**20

Kind = Literal["stream", "kept", "status"]


class DamagedMessage(ValueError):
    """A message of another form than this module writes."""


@dataclass(frozen=True, kw_only=True)
class SessionMessage:
    """From a session.

    Attributes:
        kind: ``stream`` and ``kept`` are for pages, a kept one also for those that come later; ``status`` is for the server.
        key: a newer message of the same key replaces it. content: bytes, of a status JSON.
    """

    kind: Kind
    key: str
    content: bytes

    def packed(self) -> bytes:
        """As it is sent."""
        return json.dumps([self.kind, self.key]).encode() + b"\n" + self.content

    @classmethod
    def unpacked(cls, raw: bytes) -> SessionMessage:
        """From what was received; raises DamagedMessage."""
        head, _, content = raw.partition(b"\n")
        try:
            kind, key = _HEAD.validate_json(head)
        except ValidationError as error:
            raise DamagedMessage(f"{head[:80]!r}: {error.errors()[0]['msg']}") from None
        return cls(kind=kind, key=key, content=content)


def packed_request(name: str, values: Mapping[str, Any]) -> bytes:
    """What a page asks of a session."""
    return json.dumps([name, values]).encode()


def unpacked_request(raw: bytes) -> tuple[str, dict[str, Any]]:
    """Name and values; raises DamagedMessage."""
    try:
        return _REQUEST.validate_json(raw)
    except ValidationError as error:
        raise DamagedMessage(f"{raw[:80]!r}: {error.errors()[0]['msg']}") from None


@dataclass(frozen=True, kw_only=True)
class LiveCamera:
    """Of a camera of a live session: its health and its figures."""

    state: str
    text: str
    rate_hz: float
    replaced: float = 0.0


@dataclass(frozen=True, kw_only=True)
class LiveOutputState:
    """Of an output of a live session, see `posefuse.core.OutputHealth`."""

    state: str
    text: str
    where: str
    taken: int


@dataclass(frozen=True, kw_only=True)
class LiveRecording:
    """The recording that runs: its folder in the workspace, and for how long."""

    folder: str
    seconds: float


@dataclass(frozen=True, kw_only=True)
class LiveStatus:
    """State of a live session. `wanted`: options of outputs that were switched on; `person`: whose angles are shown."""

    cameras: dict[str, LiveCamera]
    sizes: dict[str, tuple[int, int]]
    outputs: dict[str, LiveOutputState]
    wanted: dict[str, dict[str, Any]]
    people: list[int]
    names: dict[int, str]
    person: int | None
    plots: list[str]
    latency_p95_ms: float
    recording: LiveRecording | None
    news: list[str]
    refused: list[str]


@dataclass(frozen=True, kw_only=True)
class WatchCamera:
    """Of a camera that is watched without tracking."""

    state: str
    text: str
    rate_hz: float
    missing: int
    size_wh: tuple[int, int] | None


@dataclass(frozen=True, kw_only=True)
class WatchStatus:
    """State of cameras that are watched, and of what of a target was seen: see `work.watch`."""

    cameras: dict[str, WatchCamera]
    target: bool
    words: str
    enough: bool
    together: list[list[int]]
    record: str
    seconds: float


_HEAD: TypeAdapter[tuple[Kind, str]] = TypeAdapter(tuple[Kind, str])
_REQUEST: TypeAdapter[tuple[str, dict[str, Any]]] = TypeAdapter(tuple[str, dict[str, Any]])
_STATUS: Mapping[str, TypeAdapter[Any]] = {LIVE: TypeAdapter(LiveStatus), WATCH: TypeAdapter(WatchStatus)}


def packed_status(values: Mapping[str, Any]) -> bytes:
    """The state of a session."""
    return json.dumps(values).encode()


def unpacked_status(work: str, content: bytes) -> dict[str, Any]:
    """The state of a session of this kind, as plain values that are all there; raises DamagedMessage."""
    schema = _STATUS[work]
    try:
        return dict(schema.dump_python(schema.validate_json(content)))
    except ValidationError as error:
        first = error.errors()[0]
        raise DamagedMessage(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from None
