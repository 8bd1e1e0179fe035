"""What every output states about a recording: its rate, when it was recorded, who each file is of."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np

from posefuse.core import PoseSequence, Recording

# 2000-01-01; sessions of videos and of the simulator may count from zero
_FIRST_YEAR_NS = 946_684_800 * 10**9


def rate_hz(poses: PoseSequence) -> float:
    """Time steps per second: the median over the recording; 1 for a single time step, which has none."""
    return 1e9 / float(np.median(np.diff(poses.t_ns))) if len(poses) > 1 else 1.0


def duration_s(poses: PoseSequence) -> float:
    """From the first time step to the last."""
    return float(poses.t_ns[-1] - poses.t_ns[0]) * 1e-9 if len(poses) else 0.0


def recorded_utc(provenance: Mapping[str, Any]) -> str:
    """When the camera stated that it recorded, or the live session began, as ``2026-01-31T12:00:00Z``; empty if not known."""
    if "recorded" in provenance:
        return str(provenance["recorded"])
    start_ns = provenance.get("start_ns")
    if isinstance(start_ns, int) and start_ns > _FIRST_YEAR_NS:
        return datetime.fromtimestamp(start_ns * 1e-9, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return ""


def person_file(recording: Recording, n: int, ending: str) -> str:
    """``pose.trc``, or ``pose_person3.trc`` where there are several people, for formats that hold one.

    Of people with names, ``pose_person3_anna.trc``: two people may have one name.
    """
    return f"pose{person_suffix(recording, n)}{ending}"


def person_suffix(recording: Recording, n: int) -> str:
    """The part of file names that identifies the person; empty where there is one person."""
    ids = recording.poses.person_id
    if len(ids) == 1:
        return ""
    name = recording.person_names[n]
    known = re.sub(r"[^\w-]+", "_", name.lower()).strip("_") if name != f"person {ids[n]}" else ""
    return f"_person{ids[n]}" + (f"_{known}" if known else "")
