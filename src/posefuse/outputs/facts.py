"""What every output states about a recording: how it was made, its rate, the uncertainty of a point."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np

from posefuse import __version__
from posefuse.core import PoseSequence, Recording
from posefuse.core.arrays import Array


def provenance(recording: Recording) -> dict[str, Any]:
    """The recording's own provenance, with the version and the rig id it must never be without."""
    return {"version": __version__, "rig_id": recording.rig.id} | dict(recording.provenance)


def provenance_text(recording: Recording) -> str:
    """The provenance as one line of ASCII JSON."""
    return json.dumps(provenance(recording), ensure_ascii=True, default=str)


def rate_hz(poses: PoseSequence) -> float:
    """Time steps per second: the median over the recording; 1 for a single time step, which has none."""
    return 1e9 / float(np.median(np.diff(poses.t_ns))) if len(poses) > 1 else 1.0


def sigma_m(poses: PoseSequence) -> Array:
    """(T, N, K) standard deviation of a point along one axis: root of the mean variance; NaN where missing."""
    return np.asarray(np.sqrt(np.trace(poses.cov_world, axis1=-2, axis2=-1) / 3))


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
