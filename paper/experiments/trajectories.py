"""Joints over time against the truth, as plots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from posefuse.core import PoseSequence, pick_keypoints
from posefuse.evaluation import true_xyz_at
from posefuse.formats.page import Line, Plot

from .runs import Run


def trajectories(done: Run, joints: Sequence[str], sequences: Mapping[str, PoseSequence], seconds: float) -> list[Plot]:
    """A plot per joint and axis of the first `seconds`: the truth, and the first person of each sequence at its time steps."""
    t_ns = done.recording.poses.t_ns
    inside = (t_ns <= done.truth.t_ns[-1]) & (t_ns - t_ns[0] < seconds * 1e9)
    t_s = (t_ns[inside] - t_ns[0]) / 1e9
    true_xyz = true_xyz_at(done.truth, t_ns[inside])[:, 0]
    drawn = []
    for joint in joints:
        places = {"truth": pick_keypoints(true_xyz, done.truth.skeleton, [joint])[:, 0]}
        for name, poses in sequences.items():
            places[name] = pick_keypoints(poses.xyz_world[inside, 0], poses.skeleton, [joint])[:, 0]
        for axis, named in enumerate("xyz"):
            lines = [Line(name, t_s, xyz[:, axis]) for name, xyz in places.items()]
            drawn.append(Plot(f"{joint.replace('_', ' ')}, {named}", lines, x_label="s", y_label="m"))
    return drawn
