"""What a live session is given and what it leaves, whether its cameras are on this machine or on others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from posefuse.core import Skeleton

from .config import LiveConfig
from .fusion import Fusion
from .output_plan import OutputEvent, OutputPlan


@dataclass(frozen=True, kw_only=True)
class Finished:
    """What a session leaves behind: figures for tables and reports.

    Attributes:
        fusion: with its latencies and monitor. skeleton: of the detections.
        zero_ns: session time of its 0 s: recorded sources show their time 0 then, or the wait for other machines began.
        seconds: how long it ran. stopped_by: name of the signal that ended it; empty when none did.
        outputs: per output, what happened to what it was given. output_events: what changed.
        outputs_failed: whether any output failed at any time. lost: messages the outputs' process never got.
        restarts: of camera processes.
        cpu_s: processor time of the fusion process during the session, and of all its children, their start included.
        memory_mb: most memory of this process and its camera processes, added up.
        clock_offset_s: by camera, on several machines only; NaN while it is not known.
    """

    fusion: Fusion
    skeleton: Skeleton
    zero_ns: int
    seconds: float
    stopped_by: str
    outputs: Mapping[str, Mapping[str, Any]]
    output_events: Sequence[OutputEvent]
    outputs_failed: bool
    lost: int
    restarts: int
    cpu_s: tuple[float, float]
    memory_mb: float
    clock_offset_s: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class SessionPlan:
    """What a session is to do, wherever its views come from.

    Attributes:
        outputs: where results go, with the cameras and the clock. config: all settings.
        duration_s: the session ends after this time; None: no limit.
        remote: views come from other machines, whose clocks are compared on the way.
    """

    outputs: OutputPlan
    config: LiveConfig
    duration_s: float | None
    remote: bool
