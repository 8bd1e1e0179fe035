"""What a live session is given and what it leaves, whether its cameras are on this machine or on others."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from posefuse.core import Skeleton

from .config import LiveConfig
from .fusion import Fusion
from .output_plan import OutputEvent, OutputPlan
from .pace import LEAST_CAMERAS, LEAST_SHARE


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


def closing_lines(fusion: Fusion) -> Iterator[str]:
    """What there is to report at the end of a session: that this machine was too slow, and why no person was ever tracked."""
    sources = [source for name in fusion.rig.names if (source := fusion.monitor.source(name)) is not None]
    came, images = sum(source.captured for source in sources), sum(fusion.used.values())
    slow = images < LEAST_SHARE * came
    if slow:
        yield f"in all, {images / came:.0%} of the images were processed"
    if fusion.poses_with_people:
        return
    seen = [name for name, count in fusion.seen.items() if count]
    if not images:
        why = "no image of any camera was processed"
    elif slow:
        why = "this computer is too slow for these cameras"
    elif len(seen) < LEAST_CAMERAS:
        where = f"in one camera only ({seen[0]})" if seen else "in none"
        why = f"people were seen {where} of {len(fusion.seen)} cameras; {LEAST_CAMERAS} at once are needed"
    else:
        why = f"people were seen by {', '.join(seen)}, but not at one place: is the calibration the one of these cameras?"
    yield f"no person was tracked: {why}"
