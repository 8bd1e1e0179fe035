"""OpenSim motion files (.mot): a header, then one row per time step, tab-separated. Write only."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from posefuse.core import InputError, JointAngles, ShapeError
from posefuse.core.arrays import Array, frozen_fields
from posefuse.core.skeleton import SIDES
from posefuse.foundation.output_file import write_lines

# as long as skeleton.bvh holds a pose
_LONGEST_BRIDGE_S = 0.5
# OpenSim's X, Y and Z as places of the world's axes
_WORLD_AXES = [1, 2, 0]

# Names that OpenSim uses for joint angles, as names of posefuse with a sign.
#
# Coordinates of the full-body models of OpenSim (Rajagopal et al. 2016): axes X forward, Y up, Z to the right, so a positive
# rotation of the pelvis about Z tilts it backward. Sides are ``_r`` and ``_l``; flexion, adduction and internal rotation are
# positive on both.

_BOTH_SIDES = {
    "hip_flexion": ("hip", "flexion", 1),
    "hip_adduction": ("hip", "adduction", 1),
    "hip_rotation": ("hip", "internal_rotation", 1),
    "knee_angle": ("knee", "flexion", 1),
    "ankle_angle": ("ankle", "dorsiflexion", 1),
    "subtalar_angle": ("ankle", "inversion", 1),
    "arm_flex": ("arm", "flexion", 1),
    "arm_add": ("arm", "adduction", 1),
    "arm_rot": ("arm", "internal_rotation", 1),
    "elbow_flex": ("elbow", "flexion", 1),
    "pro_sup": ("wrist", "pronation", 1),
    "wrist_flex": ("wrist", "flexion", 1),
    "wrist_dev": ("wrist", "ulnar_deviation", 1),
}
_TRUNK = {
    "pelvis_tilt": ("pelvis", "tilt_forward", -1),
    "pelvis_list": ("pelvis", "obliquity_right_down", 1),
    "pelvis_rotation": ("pelvis", "rotation_left", 1),
    "lumbar_extension": ("trunk", "flexion", -1),
    "lumbar_bending": ("trunk", "bend_right", 1),
    "lumbar_rotation": ("trunk", "rotation_left", 1),
}
# OpenSim's name -> joint, angle and sign
OPENSIM = _TRUNK | {
    f"{name}_{side[0]}": (f"{side}_{joint}", angle, sign) for side in SIDES for name, (joint, angle, sign) in _BOTH_SIDES.items()
}


@dataclass(frozen=True, eq=False, kw_only=True)
class MotTable:
    """Named quantities over time, as OpenSim stores them.

    Attributes:
        name: first line of the file.
        t_s: (T,) seconds, strictly increasing.
        columns: names of axis Q, without ``time``.
        values: (T, Q); angles in degrees, translations in metres.
    """

    name: str
    t_s: Array
    columns: tuple[str, ...]
    values: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(self.columns))
        sizes = frozen_fields(self, {"t_s": "T", "values": "T Q"})
        if sizes["Q"] != len(self.columns) or len(set(self.columns)) != len(self.columns):
            raise ShapeError(f"MotTable: expected {sizes['Q']} different column names, got {len(set(self.columns))}")


class PersonMotion(NamedTuple):
    """A person's angles for OpenSim. note: what was bridged or left out, in one line; empty where nothing was."""

    table: MotTable
    note: str


def motion_from_joints(joints: JointAngles, person: int = 0, name: str = "posefuse") -> PersonMotion:
    """One person's angles as coordinates of OpenSim's full-body models, in degrees; session seconds.

    Names and signs are those of `OPENSIM`; an angle without one is ``joint_angle``. ``pelvis_tx``, ``_ty``, ``_tz`` (metres),
    ``_tilt``, ``_list`` and ``_rotation`` place the pelvis among the points of ``pose.trc``.

    OpenSim's readers end at the first unknown value. Rows are the longest time in which the person (half of what is ever known)
    is never gone for more than 0.5 s; a column is bridged in straight lines, or left out where it is unknown for longer at a
    time.
    """
    columns = _coordinates(joints, person)
    t_s = joints.t_ns * 1e-9
    known = np.isfinite(np.stack(list(columns.values())))
    # the whole-body fit carries a pelvis on for a while, and nothing else
    rows = longest_presence(t_s, known.sum(axis=0) > known.any(axis=1).sum() / 2)
    whole, t_s = len(rows) == len(t_s), t_s[rows]
    kept: dict[str, Array] = {}
    bridged, left_out = 0, []
    for column, values in columns.items():
        known = np.isfinite(values[rows])
        if not known.any():
            continue
        if np.diff(np.concatenate([t_s[:1], t_s[known], t_s[-1:]])).max() > _LONGEST_BRIDGE_S:
            left_out.append(column)
            continue
        bridged += not known.all()
        kept[column] = np.interp(t_s, t_s[known], values[rows][known])
    notes = [] if whole or not len(t_s) else [f"holds {t_s[0]:.2f} to {t_s[-1]:.2f} s, the longest time the person is there"]
    notes += [f"gaps of up to {_LONGEST_BRIDGE_S} s bridged in {bridged} columns"] if bridged else []
    notes += [f"left out, unknown for longer: {', '.join(left_out)}"] if left_out else []
    values = np.stack(list(kept.values()), axis=1) if kept else np.zeros((len(t_s), 0))
    return PersonMotion(MotTable(name=name, t_s=t_s, columns=tuple(kept), values=values), "; ".join(notes))


def _coordinates(joints: JointAngles, person: int) -> dict[str, Array]:
    """Columns (T,) of a .mot by name, in degrees and metres; NaN where unknown."""
    pelvis = joints.world_from_segment[:, person, joints.segments.index("pelvis")]
    # axes of OpenSim's ground, as `write_trc` writes points
    ground_from_pelvis, place = pelvis.matrix()[:, _WORLD_AXES], pelvis.xyz[:, _WORLD_AXES]
    columns = {f"pelvis_{name}": values for name, values in _turns(ground_from_pelvis).items()}
    columns |= {f"pelvis_t{axis}": place[:, i] for i, axis in enumerate("xyz")}
    names = {(joint, angle): (name, sign) for name, (joint, angle, sign) in OPENSIM.items()}
    for j, joint in enumerate(joints.joints):
        for a, angle in enumerate(joints.angle_names[j]):
            name, sign = names.get((joint, angle), (f"{joint}_{angle}", 1))
            columns.setdefault(name, sign * np.degrees(joints.angle_rad[:, person, j, a]))
    return columns


def _turns(rotation: Array) -> dict[str, Array]:
    """Degrees about Z, X and Y, in the sequence of the models' free joint, of rotations (T, 3, 3)."""
    about_y = np.arctan2(-rotation[:, 2, 0], rotation[:, 2, 2])
    known = np.isfinite(about_y)
    about_y[known] = np.unwrap(about_y[known])
    about_z, about_x = np.arctan2(-rotation[:, 0, 1], rotation[:, 1, 1]), np.arcsin(np.clip(rotation[:, 2, 1], -1, 1))
    return {"tilt": np.degrees(about_z), "list": np.degrees(about_x), "rotation": np.degrees(about_y)}


def longest_presence(t_s: Array, known: Array) -> Array:
    """Numbers of the time steps from the first to the last of the longest time without a gap that is too long to bridge."""
    there = np.flatnonzero(known)
    pieces = np.split(there, np.flatnonzero(np.diff(t_s[there]) > _LONGEST_BRIDGE_S) + 1)
    longest = max(pieces, key=lambda piece: t_s[piece[-1]] - t_s[piece[0]] if len(piece) else 0.0)
    return np.arange(longest[0], longest[-1] + 1) if len(longest) else longest


def write_mot(path: Path, motion: MotTable) -> None:
    """Write a .mot file; raises InputError for an unknown value, at which OpenSim would end to read without a word."""
    unknown = np.argwhere(~np.isfinite(motion.values))
    if len(unknown):
        row, column = unknown[0]
        raise InputError(f"{path}: {motion.columns[column]} is unknown at {motion.t_s[row]:.2f} s; expected a number in each row")
    header = [
        motion.name.replace("\n", " "), "version=1", f"nRows={len(motion.t_s)}", f"nColumns={len(motion.columns) + 1}",
        "inDegrees=yes", "endheader", "\t".join(("time", *motion.columns)),
    ]  # fmt: skip
    rows = ("\t".join((f"{t:.9f}", *(f"{x:.10g}" for x in row))) for t, row in zip(motion.t_s, motion.values, strict=True))
    write_lines(path, itertools.chain(header, rows))
