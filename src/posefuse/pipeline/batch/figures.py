"""The figures of a trial for the table of a study."""

from __future__ import annotations

from typing import Any

import numpy as np

from posefuse.core import InputError, PoseSequence, Recording
from posefuse.core.arrays import known_median
from posefuse.core.poses import point_sigma_m
from posefuse.core.skeleton import SIDES
from posefuse.evaluation.gait_cycles import gait_cycles
from posefuse.evaluation.report import RANGES
from posefuse.kinematics import joints_from_poses
from posefuse.kinematics.gait import Gait, gait_from_poses
from posefuse.outputs.provenance import duration_s


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
