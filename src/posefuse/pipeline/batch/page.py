"""The summary of a study: what failed, and parameters by participant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from posefuse import __version__
from posefuse.core import InputError, PoseSequence, Recording
from posefuse.core.arrays import Array, known_median, sample_sd
from posefuse.core.poses import point_sigma_m
from posefuse.core.skeleton import SIDES
from posefuse.evaluation.gait_cycles import gait_cycles
from posefuse.evaluation.report import RANGES
from posefuse.formats.page import Block, Cards, Heading, Note, Page, Table
from posefuse.kinematics import joints_from_poses
from posefuse.kinematics.gait import Gait, gait_from_poses
from posefuse.outputs.provenance import duration_s

# The figures of a trial for the table of a study.


def recording_figures(recording: Recording) -> dict[str, Any]:
    """Of the recording and of the first person's walk; gait is left out where they do not walk."""
    poses = recording.poses
    figures = quality_figures(poses, len(recording.rig))
    gait = gait_from_poses(poses, 0) if len(poses.person_id) else None
    return figures if gait is None else figures | _gait_figures(gait) | _angle_figures(recording, gait)


def quality_figures(poses: PoseSequence, cameras: int) -> dict[str, Any]:
    """How long, how many, how complete and how exact; NaN where nothing is known."""
    sigma_m = point_sigma_m(poses.cov_world)
    known = np.isfinite(poses.xyz_world[..., 0])
    return {
        "duration_s": duration_s(poses),
        "time_steps": len(poses),
        "cameras": cameras,
        "people": len(poses.person_id),
        "present_share": float(known.mean()) if known.size else float("nan"),
        "median_sigma_mm": 1000 * known_median(sigma_m),
        "median_reprojection_px": known_median(poses.reproj_px),
    }


def _gait_figures(gait: Gait) -> dict[str, Any]:
    return {
        "speed_m_s": gait.speed_m_s,
        "cadence_per_min": gait.cadence_per_min,
        "stride_length_m": gait.stride_length_m.mean,
        "step_width_m": gait.step_width_m.mean,
        **{f"stance_{side}_share": gait.stance_share[side].mean for side in SIDES},
    }


def _angle_figures(recording: Recording, gait: Gait) -> dict[str, Any]:
    try:
        cycles = gait_cycles(joints_from_poses(recording.poses), 0, gait)
    except InputError:
        return {}
    found: dict[str, Any] = {}
    for one in cycles:
        joint = one.joint.removeprefix(f"{one.side}_")
        if (joint, one.angle) in RANGES:
            found[f"range_{one.side}_{joint}_{one.angle}_deg"] = float(np.degrees(one.ranges_rad.mean()))
    return found


Rows = Sequence[Mapping[str, Any]]
PARAMETERS = {
    "speed_m_s": ("speed, m/s", 1.0, 2),
    "cadence_per_min": ("cadence, steps/min", 1.0, 0),
    "stride_length_m": ("stride length, m", 1.0, 2),
    "step_width_m": ("step width, m", 1.0, 2),
    "stance_left_share": ("stance left, %", 100.0, 0),
    "stance_right_share": ("stance right, %", 100.0, 0),
    **{
        f"range_{side}_{joint}_{angle}_deg": (f"{side} {joint} {angle} range, °", 1.0, 0)
        for joint, angle in RANGES
        for side in SIDES
    },
    "median_sigma_mm": ("median standard deviation of a keypoint, mm", 1.0, 1),
}


def study_page(title: str, rows: Rows) -> Page:
    """The page of a study from the rows of its table.

    Means are of the trials of each participant, then of participants, so that many trials of one do not count more.
    """
    participants = list(dict.fromkeys(str(row["participant"]) for row in rows))
    failed = [row for row in rows if row["reason"]]
    counts = {"participants": len(participants), "trials": len(rows), "complete": len(rows) - len(failed), "failed": len(failed)}
    blocks: list[Block] = [Cards({name: str(count) for name, count in counts.items()})]
    if failed:
        lines = [[row["participant"], row["trial"], row["reason"]] for row in failed]
        blocks += [
            Heading("Failed trials", "All others are complete."),
            Table(["participant", "trial", "reason"], lines, text=True),
        ]
    blocks += _parameters(participants, rows)
    blocks += [Heading("Trials"), _trials(rows)]
    return Page(title, blocks, subtitle=f"summary of a study, posefuse {__version__}")


def _parameters(participants: Sequence[str], rows: Rows) -> list[Block]:
    known = [name for name in PARAMETERS if any(_is_number(row.get(name)) for row in rows)]
    if not known:
        return [Note("No parameters: no trial is complete.")]
    columns = ["parameter", "all participants", *participants]
    lines = []
    for name in known:
        title, scale, digits = PARAMETERS[name]
        by_participant = [_values(rows, participant, name) * scale for participant in participants]
        means = np.array([values.mean() for values in by_participant if len(values)])
        lines.append([title, _spread(means, digits), *(_spread(values, digits) for values in by_participant)])
    note = "Mean ± standard deviation (number): of participants in the second column, of the trials of each in the others."
    return [Heading("Parameters by participant", note), Table(columns, lines, text=True)]


def _trials(rows: Rows) -> Table:
    lines = [[row["participant"], row["trial"], row["status"], f"{row['seconds']:.0f}", row["warnings"]] for row in rows]
    return Table(["participant", "trial", "status", "seconds", "warnings"], lines, text=True)


def _values(rows: Rows, participant: str, name: str) -> Array:
    return np.array([row[name] for row in rows if row["participant"] == participant and _is_number(row.get(name))], float)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and bool(np.isfinite(value))


def _spread(values: Array, digits: int) -> str:
    if not len(values):
        return ""
    mean = f"{values.mean():.{digits}f}"
    return f"{mean} ± {sample_sd(values):.{digits}f} ({len(values)})" if len(values) > 1 else f"{mean} (1)"
