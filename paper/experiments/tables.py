"""Rows of tables, plots of joints over time and images with skeletons, as several experiments show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from paper.scenes.paper import Column
from posefuse.core import PAPER14, Array, PoseSequence, pick_keypoints
from posefuse.evaluation import JointErrors, true_xyz_at
from posefuse.formats.page import Line, Plot
from posefuse.sources import Seeker, VideoConfig, nearest
from posefuse_sim import SessionPaths

from .runs import Run

# columns of the summary, and those of them that other bodies check
_SHOWN = ("none", "score", "all", "robust", "default", "best networks")
CHECKED = ("default", "best networks")


def shown(columns: Mapping[str, Any]) -> dict[str, Any]:
    """Those of the columns that the summary shows joint by joint."""
    return {name: columns[name] for name in _SHOWN if name in columns}


def errors_row(errors: JointErrors) -> dict[str, Any]:
    """Plain figures of a column of the tables."""
    return {
        "mean_mm": errors.mpjpe_mm,
        "worst_joint": errors.joints[int(np.nanargmax(errors.mean_mm))],
        "worst_mm": float(np.nanmax(errors.mean_mm)),
        "found": float(errors.found.mean()),
        "joints": {
            joint: {"mean_mm": float(errors.mean_mm[i]), "sd_mm": float(errors.sd_mm[i]), "p95_mm": float(errors.p95_mm[i])}
            for i, joint in enumerate(errors.joints)
        },
    }


def joint_rows(
    columns: Mapping[str, Mapping[str, Any]],
    paper: Mapping[str, Column],
    stated: Mapping[str, tuple[float, float, float]] | None = None,
) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the paper's table: 14 joints with mean +- sd, then average, best and worst joint.

    Args:
        columns: ours, as `errors_row` gives them. paper: its columns, shown behind ours.
        stated: columns of which only average, best and worst are known.
    """
    ours = {
        name: {joint: (of["mean_mm"], of["sd_mm"]) for joint, of in column["joints"].items()} for name, column in columns.items()
    }
    known: dict[str, Column] = {**ours, **{f"paper: {name}": column for name, column in paper.items()}}
    stated = stated or {}
    rows = [
        [joint.replace("_", " "), *(_mean_sd(*column[joint]) for column in known.values()), *("–" for _ in stated)]
        for joint in PAPER14.keypoints
    ]
    sums = [[np.nanmean(means), np.nanmin(means), np.nanmax(means)] for means in map(_means, known.values())]
    for i, what in enumerate(("average", "best joint", "worst joint")):
        rows.append([what, *(f"{one[i]:.2f}" for one in (*sums, *stated.values()))])
    return ["joint (mm)", *known, *stated], rows


def _means(column: Column) -> list[float]:
    return [mean for mean, _ in column.values()]


def _mean_sd(mean: float | None, sd: float | None) -> str:
    return "–" if mean is None or sd is None or not np.isfinite(mean) else f"{mean:.1f} ± {sd:.1f}"


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


def drawn_images(run: Run, camera: int, time_steps: Sequence[int], width_px: int = 480) -> dict[str, Array]:
    """Captions to images of one camera at time steps of the recording, with the fused skeleton drawn in."""
    from posefuse.outputs import view_tile

    width, height = run.recording.rig.cameras[camera].size_wh
    tile_wh = (width_px, round(width_px * height / width))
    return {
        f"{run.recording.rig.names[camera]}, {run.recording.poses.t_ns[i] / 1e9:.2f} s": view_tile(
            run.recording, i, camera, image, tile_wh
        )
        for i, image in images_at(run, camera, time_steps).items()
    }


def images_at(run: Run, camera: int, time_steps: Sequence[int]) -> dict[int, Array]:
    """What a camera saw at time steps of the recording, in their order."""
    name = run.recording.rig.names[camera]
    with Seeker(VideoConfig(SessionPaths(run.folder).video(name), name).build()) as video:
        wanted = {i: nearest(video.times_ns, int(run.recording.poses.t_ns[i])) for i in sorted(map(int, time_steps))}
        return {i: np.array(video.at(frame).image) for i, frame in wanted.items()}
