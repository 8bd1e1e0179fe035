"""Joint angles over the gait cycle: every stride from 0 to 100 %, foot strike to the next strike of the same foot."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from posefuse.core import JointAngles
from posefuse.core.arrays import Array, sample_sd
from posefuse.core.skeleton import SIDES
from posefuse.formats.page import Side
from posefuse.foundation.output_file import atomic_file
from posefuse.kinematics.gait import Gait

PERCENT = np.linspace(0.0, 100.0, 101)
# of the median stride: a longer one holds a turn or a stop
_SHORTEST, _LONGEST = 0.5, 1.5
_LEAST_KNOWN = 0.9
HEADING = ("pelvis", "rotation_left")


@dataclass(frozen=True, eq=False)
class CycleAngles:
    """One angle over the cycles of one foot.

    Attributes:
        joint, angle: names as in `JointAngles`. side: of the foot whose strikes bound the cycles.
        begin_s, end_s: (M,) session seconds. angle_rad: (M, 101), every percent of each cycle.
    """

    joint: str
    angle: str
    side: Literal["left", "right"]
    begin_s: Array
    end_s: Array
    angle_rad: Array

    @property
    def mean_rad(self) -> Array:
        """(101,) mean over the cycles."""
        return np.asarray(self.angle_rad.mean(axis=0))

    @property
    def sd_rad(self) -> Array:
        """(101,) sample standard deviation over the cycles; zero for one."""
        return sample_sd(self.angle_rad)

    @property
    def ranges_rad(self) -> Array:
        """(M,) greatest minus least angle of each cycle."""
        return np.asarray(np.ptp(self.angle_rad, axis=1))


def side_of(joint: str) -> Side:
    """``left`` or ``right`` of a joint's or keypoint's name, ``mid`` for the others."""
    return "left" if joint.startswith("left_") else "right" if joint.startswith("right_") else "mid"


def gait_cycles(joints: JointAngles, person: int, gait: Gait) -> list[CycleAngles]:
    """Every angle that at least one whole cycle has, in the order of `joints`.

    Joints of a side are cut at the strikes of that foot, joints of the trunk at those of the left foot. Left out are cycles much
    shorter or longer than the median, and those in which less than 90 % of the angle is known; gaps are bridged linearly.
    The rotation of the pelvis, which the world's axes define, is taken relative to the mean heading of the stride.
    """
    t_s = joints.t_ns * 1e-9
    spans = _cycles(gait)
    found = []
    for q, joint in enumerate(joints.joints):
        side: Literal["left", "right"] = "right" if side_of(joint) == "right" else "left"
        for a, angle in enumerate(joints.angle_names[q]):
            known = np.isfinite(joints.angle_rad[:, person, q, a])
            known_s, known_rad = t_s[known], joints.angle_rad[known, person, q, a]
            kept = [
                (begin, end, values)
                for begin, end in spans[side]
                if (values := _resampled(t_s, known_s, known_rad, begin, end)) is not None
            ]
            if (joint, angle) == HEADING:
                kept = [(begin, end, values - np.linspace(*_turn(values))) for begin, end, values in kept]
            if kept:
                begins, ends, values = (np.array(column) for column in zip(*kept, strict=True))
                found.append(CycleAngles(joint, angle, side, begins, ends, values))
    return found


def write_gait_cycles(path: Path, cycles: dict[int, list[CycleAngles]]) -> Path:
    """CSV, one row per person, angle and cycle: person, joint, angle, side, cycle, begin_s, end_s, then degrees at 0 to 100 %.

    Raises:
        InputError: it cannot be written there.
    """
    with atomic_file(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["person", "joint", "angle", "side", "cycle", "begin_s", "end_s", *(f"deg_at_{p:.0f}" for p in PERCENT)])
        for person, angles in cycles.items():
            for one in angles:
                for i, (begin, end, values) in enumerate(zip(one.begin_s, one.end_s, one.angle_rad, strict=True), start=1):
                    head = [person, one.joint, one.angle, one.side, i, f"{begin:.4f}", f"{end:.4f}"]
                    rows.writerow([*head, *(f"{value:.3f}" for value in np.degrees(values))])
    return path


def _cycles(gait: Gait) -> dict[str, list[tuple[float, float]]]:
    spans = {side: [(float(a), float(b)) for a, b in pairwise(gait.strike_s[side])] for side in SIDES}
    usual_s = float(np.median([end - begin for both in spans.values() for begin, end in both]))
    return {
        side: [(begin, end) for begin, end in both if _SHORTEST * usual_s <= end - begin <= _LONGEST * usual_s]
        for side, both in spans.items()
    }


def _turn(values: Array) -> tuple[float, float, int]:
    """Heading at begin and end of a stride, which turns evenly by what it turns in all, and the number of values."""
    half = float(values[-1] - values[0]) / 2
    return float(values.mean()) - half, float(values.mean()) + half, len(values)


def _resampled(t_s: Array, known_s: Array, known_rad: Array, begin: float, end: float) -> Array | None:
    (first, last), (all_first, all_last) = (
        (np.searchsorted(times, begin), np.searchsorted(times, end, "right")) for times in (known_s, t_s)
    )
    count = all_last - all_first
    if not count or (last - first) / count < _LEAST_KNOWN:
        return None
    around = slice(max(0, first - 1), last + 1)
    return np.asarray(np.interp(begin + (end - begin) * PERCENT / 100, known_s[around], known_rad[around]))
